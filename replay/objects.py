"""The objects of a finished run, and what else is asked of the surface of its map."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proground_log.camera import transform
from proground_log.errors import ProgroundError
from proground_log.files import written_whole
from proground_log.frame import SensorFrame
from proground_log.locations import located
from proground_log.log.reader import LogReader
from proground_log.log.upright import levelled, nearest_axis, up_direction
from proground_log.mapping.map_file import NeuralMap, load_map
from proground_log.perception.description import PerceptionDescription
from proground_log.query.boxes import OrientedBox
from proground_log.query.grounding import background_probability, vertex_logits
from proground_log.query.objects import SceneObject, find_objects
from proground_log.query.surface import Mesh, extract_mesh
from replay.manifest import Manifest, open_log_of
from replay.run_folder import RunFolder

VOXEL_M = 0.03
"""Voxels of the surface whose objects are listed and judged: a cup has some fifty vertices."""
POINTS_AT_ONCE = 32768
"""Vertices at once: embeddings of all would fill the memory."""
VIEWS_FOR_UP = 50
"""Frames, evenly spaced, whose poses say what is up."""
LEVEL_DEG = 5.0
"""An axis of the world this near to up is up: the world was meant to stand on it."""
SAMPLES = 100
"""Vertices of an object that are looked for in each frame."""
SEEN_SHARE = 0.2
"""A frame saw an object if it saw so many of its vertices."""
HIDDEN_M = 0.1
"""What was measured this much in front of a vertex hides it."""


@dataclass(frozen=True)
class Surface:
    """A map's surface, ready to be asked.

    Args:
        content: the map; it has semantics.
        mesh: its surface, V vertices.
        voxel_m: voxels of the mesh.
        up: float64 [3], the world's upward direction.
    """

    content: NeuralMap
    mesh: Mesh
    voxel_m: float
    up: np.ndarray

    @property
    def description(self) -> PerceptionDescription:
        """The task, its texts and the detector's heads."""
        assert self.content.semantics is not None
        return self.content.semantics.description

    def ask(self, texts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logits [V, K] of the vertices for texts [K, 512], and how likely background, [V]."""
        logits, background = [], []
        for start in range(0, len(self.mesh.vertices_m), POINTS_AT_ONCE):
            part_m = self.mesh.vertices_m[start : start + POINTS_AT_ONCE]
            semantics = self.content.semantics_at(part_m)
            scale_logits = semantics.scale_logits
            heads = self.description.heads
            logits.append(vertex_logits(semantics.embeddings, scale_logits, heads, texts))
            background.append(background_probability(scale_logits, semantics.uncertainty))
        return np.concatenate(logits), np.concatenate(background)

    def objects(self) -> list[SceneObject]:
        """Every object that a prompt of the task names; see `find_objects`."""
        description = self.description
        logits, background = self.ask(description.texts)
        prompts = description.task.prompts
        return find_objects(self.mesh, logits, background, prompts, self.up, self.voxel_m)


def require_meaning(content: NeuralMap, where: object) -> None:
    """Raise a ProgroundError unless a map knows what things are."""
    if content.semantics is None:
        raise ProgroundError(
            "the map knows no meaning, since its log had no regions",
            where=where,
            todo="run `pglog perceive` on the log, and replay what it gives",
        )


def require_voxels(voxel_m: float) -> None:
    """Raise a ProgroundError unless voxels have a size."""
    if not voxel_m > 0:
        raise ProgroundError(
            f"the voxels are {voxel_m} m", where="surface", todo="choose more than 0"
        )


def surface_of(content: NeuralMap, voxel_m: float, log: LogReader | None, where: Path) -> Surface:
    """Extract the surface of a map that has meaning.

    Args:
        content: the map.
        voxel_m: voxels of the mesh.
        log: its camera says what is up; z is, without it.
        where: the run, for errors.

    Raises:
        ProgroundError: there is no surface.
    """
    mesh = extract_mesh(content, voxel_m)
    if not len(mesh.vertices_m):
        raise ProgroundError(
            "the map has no surface to ask",
            where=where,
            todo="map more frames, or frames with depth within the bounds",
        )
    return Surface(content, mesh, voxel_m, _up(mesh, log))


def log_if_there(run: RunFolder, log_path: Path | None) -> LogReader | None:
    """The log of a run, checked; None where it has gone and nobody says where to."""
    manifest = Manifest.read(run.manifest)
    if log_path is None and not located(manifest.log_path).is_file():
        return None
    return open_log_of(manifest, log_path)


def objects_of_run(
    run_path: Path, voxel_m: float, log_path: Path | None = None
) -> list[SceneObject]:
    """List the objects of a finished run; where its log is there, with the frames that saw them.

    Args:
        run_path: folder of a finished run whose log had regions.
        voxel_m: voxels of the surface that is asked.
        log_path: the run's log, or None where it is where the run found it.

    Raises:
        ProgroundError: the run has no meaning or no surface, or the log is another.
    """
    require_voxels(voxel_m)
    run = RunFolder(run_path).require_finished()
    content = load_map(run.map)
    require_meaning(content, run_path)
    log = log_if_there(run, log_path)
    surface = surface_of(content, voxel_m, log, run_path)
    objects = surface.objects()
    return objects if log is None else counted_views(objects, surface.mesh, log)


def counted_views(objects: Sequence[SceneObject], mesh: Mesh, log: LogReader) -> list[SceneObject]:
    """The objects with the number of frames of the log that saw them.

    A frame saw an object if a fifth of its vertices lie in the depth image and nothing was
    measured in front of them; the sides turned away and the edges of the image are allowed for.
    """
    chosen = [
        thing.instance.vertices[:: max(1, len(thing.instance) // SAMPLES)] for thing in objects
    ]
    if not chosen:
        return []
    points_m = mesh.vertices_m[np.concatenate(chosen)].astype(np.float64)
    object_of = np.repeat(np.arange(len(chosen)), [len(part) for part in chosen])
    views = np.zeros(len(chosen), int)
    calibration = log.calibration
    for frame in log.frames():
        camera = (frame.calibration or calibration).depth.pinhole()
        seen = _in_sight(points_m, frame, camera.k_integer_centres)
        views += np.bincount(object_of, seen) >= SEEN_SHARE * np.bincount(object_of)
    return [replace(thing, views=int(n)) for thing, n in zip(objects, views, strict=True)]


def write_objects_csv(path: Path, objects: Sequence[SceneObject]) -> None:
    """Write a CSV file, a row an object, whole or not at all; lengths are in metres."""
    text = io.StringIO()
    rows = [_flat(row) for row in object_rows(objects)]
    names = list(rows[0]) if rows else ["number", "label"]
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with written_whole(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def object_rows(objects: Sequence[SceneObject]) -> list[dict[str, object]]:
    """The objects as JSON values, numbered from 1; to the millimetre and a tenth of a degree."""
    return [
        {
            "number": number,
            "label": thing.label,
            "position_m": rounded(thing.instance.position_m),
            "box": box_json(thing.box),
            "score": round(thing.instance.score, 4),
            "vertices": len(thing.instance),
            "views": thing.views,
        }
        for number, thing in enumerate(objects, start=1)
    ]


def box_json(box: OrientedBox) -> dict[str, object]:
    """An upright box as JSON values; the extent is length, width and height."""
    return {
        "centre_m": rounded(box.centre_m),
        "extent_m": rounded(box.extent_m),
        "yaw_deg": round(float(np.degrees(box.yaw_rad)), 1) + 0.0,
    }


def rounded(vector_m: np.ndarray) -> list[float]:
    """To the millimetre; adding 0 makes 0 of -0."""
    return [round(float(value), 3) + 0.0 for value in vector_m]


def _flat(row: dict[str, object]) -> dict[str, object]:
    """A row of numbers and names alone: a column for each coordinate."""
    flat: dict[str, object] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            flat |= {f"{name}_{key}": part for key, part in _flat(value).items()}
        elif isinstance(value, list):
            flat |= {f"{name}_{axis}": part for axis, part in zip("xyz", value, strict=True)}
        else:
            flat[name] = value
    return flat


def _up(mesh: Mesh, log: LogReader | None) -> np.ndarray:
    if log is None:
        return np.array([0.0, 0.0, 1.0])
    chosen = np.unique(np.linspace(0, len(log) - 1, VIEWS_FOR_UP).astype(int)).tolist()
    poses = np.stack([frame.world_from_camera for frame in log.frames(chosen)])
    up = levelled(up_direction(poses), mesh.normals)
    axis, sign = nearest_axis(up)
    if sign * up[axis] >= np.cos(np.radians(LEVEL_DEG)):
        return sign * np.eye(3)[axis]
    return up


def _in_sight(points_m: np.ndarray, frame: SensorFrame, k: np.ndarray) -> np.ndarray:
    """Which points [N, 3] a frame's depth camera saw, bool [N]."""
    camera_from_world = np.linalg.inv(frame.world_from_camera)
    points_m = transform(camera_from_world, points_m)
    depth_m = frame.depth_m
    height, width = depth_m.shape
    z = np.maximum(points_m[:, 2], 1e-3)
    column, row = np.rint((points_m @ k.T)[:, :2].T / z).astype(int)
    inside = (points_m[:, 2] > 0) & (column >= 0) & (column < width)
    inside &= (row >= 0) & (row < height)
    measured_m = depth_m[row.clip(0, height - 1), column.clip(0, width - 1)]
    return np.asarray(inside & (measured_m > points_m[:, 2] - HIDDEN_M))
