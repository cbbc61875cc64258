"""Replica as NICE-SLAM rendered it, with class images and a labelled mesh where they are there.

A scene folder has results/frame%06d.jpg, results/depth%06d.png, traj.txt (16 numbers a line,
world_from_camera) and, here or in its parent, cam_params.json; then, where there is ground truth,
semantic_class/semantic_class_%d.png, info_semantic.json and mesh_semantic*.ply.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.association import frame_stamp_ns, parse_pose, read_text
from recorders.images import numbered_files, read_color, read_depth, read_labels

FRAME_RATE_HZ = 30


@dataclass(frozen=True)
class _Files:
    """Where one frame is: its number, its images, and its line in traj.txt (from 1)."""

    number: int
    color: Path
    depth: Path
    labels: Path | None
    pose_text: str
    pose_where: str


class ReplicaSource:
    """One scene; frames are in the order of their numbers."""

    name = "replica"

    def __init__(self, source: Path, *, calibration: Calibration | None = None) -> None:
        """Find the scene's files.

        Args:
            source: the scene's folder.
            calibration: the rig; by default the one camera of cam_params.json.

        Raises:
            ProgroundError: a file is missing or broken, or there are no frames.
        """
        params_path = _here_or_above(source, "cam_params.json")
        camera, self._depth_per_m = _read_camera(params_path)
        self.calibration = calibration or Calibration.registered(camera)
        self._mesh = _only_mesh(source)
        self._frames = _find_frames(source)
        self.label_names: dict[int, str] = {}
        self.notes: dict[str, str] = {}
        self.warnings: tuple[str, ...] = ()
        if self._frames[0].labels is not None:
            self.label_names = _read_label_names(_here_or_above(source, "info_semantic.json"))

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is float32 in metres."""
        files = self._frames[index]
        color = read_color(files.color, self.calibration.color)
        depth = read_depth(files.depth, self.calibration.depth)
        stamp_ns = frame_stamp_ns(files.number, FRAME_RATE_HZ)
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=np.divide(depth, self._depth_per_m, dtype=np.float32),
            world_from_camera=parse_pose(files.pose_text, where=files.pose_where),
            labels=read_labels(files.labels, self.calibration.color) if files.labels else None,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """The bytes of mesh_semantic*.ply, where there is exactly one."""
        return self._mesh.read_bytes() if self._mesh else None


def _here_or_above(folder: Path, name: str) -> Path:
    """The file of that name in the folder, else in its parent."""
    above = folder.parent / name
    return above if above.is_file() and not (folder / name).is_file() else folder / name


def _read_json(path: Path) -> Any:
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise ProgroundError(f"is not JSON ({error})", where=path, todo="mend the file") from error


def _read_camera(path: Path) -> tuple[Camera, float]:
    """The camera, and the depth images' units per metre."""
    try:
        params = _read_json(path)["camera"]
        # Replica's cx of 599.5 at a width of 1200 counts pixel centres as whole numbers.
        fx, fy, cx, cy, depth_per_m = (float(params[k]) for k in ("fx", "fy", "cx", "cy", "scale"))
        camera = Camera.from_integer_centres(int(params["w"]), int(params["h"]), fx, fy, cx, cy)
    except (KeyError, TypeError, ValueError) as error:
        raise ProgroundError(
            f"does not describe the camera ({error!r})",
            where=path,
            todo='it needs {"camera": {w, h, fx, fy, cx, cy, scale}}, all numbers',
        ) from error
    if not (fx > 0 and fy > 0 and depth_per_m > 0):
        raise ProgroundError(
            "fx, fy and scale have to be above 0", where=path, todo="mend the file"
        )
    return camera, depth_per_m


def _read_label_names(path: Path) -> dict[int, str]:
    """Class names by class number; 0 and below mean "nothing" and have none."""
    try:
        names = {int(c["id"]): str(c["name"]) for c in _read_json(path)["classes"]}
    except (KeyError, TypeError, ValueError) as error:
        raise ProgroundError(
            f"does not name the classes ({error!r})",
            where=path,
            todo='it needs {"classes": [{"id": number, "name": text}, ...]}',
        ) from error
    return {label: name for label, name in sorted(names.items()) if label > 0}


def _only_mesh(source: Path) -> Path | None:
    meshes = list(source.glob("mesh_semantic*.ply"))
    return meshes[0] if len(meshes) == 1 else None


def _find_frames(source: Path) -> list[_Files]:
    """The frames in the order of their numbers, each of them complete."""
    results, classes = source / "results", source / "semantic_class"
    colors = numbered_files(results, r"frame(\d+)\.(?:png|jpe?g)")
    depths = numbered_files(results, r"depth(\d+)\.png")
    has_labels = classes.is_dir()
    labels = numbered_files(classes, r"semantic_class_(\d+)\.png") if has_labels else {}
    trajectory = source / "traj.txt"
    lines = read_text(trajectory).splitlines()
    if not depths:
        raise ProgroundError(
            "has no depth*.png", where=results, todo="give a scene in NICE-SLAM's layout of Replica"
        )
    frames = []
    for number, depth in depths.items():
        for missing, path in (
            (number not in colors, results / f"frame{number:06d}.jpg"),
            (has_labels and number not in labels, classes / f"semantic_class_{number}.png"),
            (number >= len(lines), f"{trajectory}:{number + 1}"),
        ):
            if missing:
                raise ProgroundError(
                    "is missing, though the frame has depth",
                    where=path,
                    todo="complete the scene, or remove what it has only in part",
                )
        where = f"{trajectory}:{number + 1}"
        frames.append(
            _Files(number, colors[number], depth, labels.get(number), lines[number], where)
        )
    return frames
