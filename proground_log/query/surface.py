"""The surface of a finished run's map, ready to be asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.special import expit

from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.log.upright import levelled, nearest_axis, up_direction
from proground_log.mapping.map_file import NeuralMap
from proground_log.perception.description import PerceptionDescription
from proground_log.query.grounding import ask_map
from proground_log.query.mesh import Mesh, extract_mesh
from proground_log.query.objects import SceneObject
from proground_log.query.objects_of_labels import objects_of_labels
from proground_log.query.objects_of_regions import objects_of_regions
from proground_log.query.sightings import Sightings, find_sightings
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.manifest import Manifest, open_log_of

VOXEL_M = 0.03
"""Voxels of the surface whose objects are listed and judged: a cup has some fifty vertices."""
MOST_FRAMES = 300
"""Frames, evenly spaced over those that were mapped, whose regions say what is one thing."""
MOST_REGIONS = 4000
"""Regions of these frames: fewer frames are looked at where they have more. Each is compared with
each, which takes 2 s and 0.7 GB."""
VIEWS_FOR_UP = 50
"""Frames, evenly spaced, whose poses say what is up."""
LEVEL_DEG = 5.0
"""An axis of the world this near to up is up: the world was meant to stand on it."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A map's surface, and the log that it was made of where that is still there.

    Args:
        run: where the map is from.
        content: the map.
        mesh: its surface, V vertices, at least one.
        voxel_m: voxels of the mesh.
        up: float64 [3], the world's upward direction.
        log: None where it has gone.
    """

    run: RunFolder
    content: NeuralMap
    mesh: Mesh
    voxel_m: float
    up: np.ndarray
    log: LogReader | None

    @property
    def description(self) -> PerceptionDescription:
        """The task, its texts and the detector's heads, of a map that has meaning."""
        assert self.content.semantics is not None
        return self.content.semantics.description

    def ask(self, texts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logits [V, K] of the vertices for texts [K, 512], and how likely background, [V]."""
        return ask_map(self.content, self.mesh.vertices_m, texts)

    @cached_property
    def sightings(self) -> Sightings | None:
        """The regions that the run learnt from; None where no log has them.

        Frames that the run did not map do not count: what came too late for it, it cannot know.
        """
        if self.log is None or self.log.task is None:
            return None
        mapped = _mapped_frames(self.run.ledger)
        chosen = [mapped[i] for i in _evenly(len(mapped), MOST_FRAMES)]
        register = Registration(self.log.calibration)
        frames = (register(frame) for frame in self.log.frames(chosen))
        found = find_sightings(self.mesh.vertices_m, frames, self.voxel_m)
        return found.thinned(MOST_REGIONS)

    @cached_property
    def objects(self) -> list[SceneObject]:
        """Every object that a prompt of the task names.

        Told apart by the regions of the log, or where there are none by the map alone.
        """
        description = self.description
        prompts = description.task.prompts
        if self.sightings is None:
            logits, background = self.ask(description.texts)
            return objects_of_labels(self.mesh, logits, background, prompts, self.up, self.voxel_m)
        relevance = expit(self.sightings.logits(description.heads, description.texts))
        return objects_of_regions(
            self.mesh, self.sightings, relevance, prompts, self.up, self.voxel_m
        )

    @property
    def caveat(self) -> str | None:
        """Why objects are told apart worse than they might be; None where they are not."""
        if self.sightings is not None:
            return None
        if self.log is None:
            why = "the run's log is not at hand (gone, out of reach or another one)"
            todo = "say with --log where it is"
        else:
            why = "the run's log has no regions"
            todo = "`pglog perceive` it, and replay what that gives"
        return f"{why}, so objects are told apart by the map alone, which is worse; {todo}"


def surface_of(
    run: RunFolder, content: NeuralMap, voxel_m: float, log: LogReader | None
) -> Surface:
    """Extract the surface of a map.

    Args:
        run: where it is from.
        content: the map.
        voxel_m: voxels of the mesh.
        log: its regions tell objects apart, and its camera says what is up; z is, without it.

    Raises:
        ProgroundError: the voxels have no size, or there is no surface.
    """
    if not voxel_m > 0:
        raise ProgroundError(
            f"the voxels are {voxel_m} m", where="surface", todo="choose more than 0"
        )
    mesh = extract_mesh(content, voxel_m)
    if not len(mesh.vertices_m):
        raise ProgroundError(
            "the map has no surface to ask",
            where=run.path,
            todo="map more frames, or frames with depth within the bounds",
        )
    return Surface(run, content, mesh, voxel_m, _up(mesh, log), log)


def require_meaning(content: NeuralMap, where: object) -> None:
    """Raise a ProgroundError unless a map knows what things are."""
    if content.semantics is None:
        raise ProgroundError(
            "the map knows no meaning, since its log had no regions",
            where=where,
            todo="run `pglog perceive` on the log, and replay what it gives",
        )


def log_if_there(run: RunFolder, log_path: Path | None) -> LogReader | None:
    """The log of a run, checked; None where nobody says where it is and it is not where it was.

    Raises:
        ProgroundError: the log at `log_path` is not there, or is another.
    """
    manifest = Manifest.read(run.manifest)
    try:
        return open_log_of(manifest, log_path)
    except ProgroundError:
        if log_path is not None:
            raise
        return None


def _mapped_frames(ledger: Path) -> list[int]:
    """Numbers of the frames that a run learnt from: neither held out nor dropped."""
    entries = [entry for entry in read_ledger(ledger) if entry["event"] in ("frame", "done")]
    held_out = {entry["frame"] for entry in entries if entry.get("held_out")}
    done = {entry["frame"] for entry in entries if entry["event"] == "done"}
    return sorted(done - held_out)


def _evenly(count: int, most: int) -> list[int]:
    """At most so many of `count` numbers, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()


def _up(mesh: Mesh, log: LogReader | None) -> np.ndarray:
    if log is None:
        return np.array([0.0, 0.0, 1.0])
    chosen: Sequence[int] = _evenly(len(log), VIEWS_FOR_UP)
    poses = np.stack([frame.world_from_camera for frame in log.frames(chosen)])
    up = levelled(up_direction(poses), mesh.normals)
    axis, sign = nearest_axis(up)
    if sign * up[axis] >= np.cos(np.radians(LEVEL_DEG)):
        return sign * np.eye(3)[axis]
    return up
