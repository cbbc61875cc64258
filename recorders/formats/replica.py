"""Replica as NICE-SLAM rendered it, with class images and a labelled mesh where they are there.

A scene folder has results/frame%06d.jpg, results/depth%06d.png, traj.txt (16 numbers a line,
world_from_camera) and, here or in its parent, cam_params.json; then, where there is ground truth,
semantic_class/semantic_class_%d.png, semantic_instance/semantic_instance_%d.png,
info_semantic.json and mesh_semantic*.ply.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.replica_labels import (
    INFO_NAME,
    find_mesh,
    read_label_names,
    truth_images,
)
from recorders.reading.frame_files import Numbered, find_frames, pose_lines
from recorders.reading.json_file import read_json
from recorders.reading.layout import holds

FRAME_RATE_HZ = 30


def recognise(source: Path) -> str | None:
    """Why a path looks like a scene in NICE-SLAM's layout of Replica; None where it does not."""
    if holds(source, "traj.txt", "results/depth*.png", "results/frame*"):
        return "has traj.txt, results/frame* and results/depth*.png"
    return None


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
        results = source / "results"
        self._frames, _ = find_frames(
            Numbered(results, r"depth(\d+)\.png", "depth{number:06d}.png"),
            Numbered(results, r"frame(\d+)\.(?:jpe?g|png)", "frame{number:06d}.jpg"),
            pose_lines(source / "traj.txt"),
            rate_hz=FRAME_RATE_HZ,
            **truth_images(source),
            todo="give a rendering of Replica",
        )
        self._mesh, self.notes = find_mesh(source)
        self.label_names: dict[int, str] = {}
        self.warnings: tuple[str, ...] = ()
        if self._frames[0].labels is not None:
            self.label_names = read_label_names(_here_or_above(source, INFO_NAME))

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is float32 in metres."""
        return self._frames[index].read(index, self.calibration, depth_per_m=self._depth_per_m)

    def ground_truth_mesh(self) -> bytes | None:
        """The bytes of *mesh_semantic*.ply, where there is one and its vertices have labels."""
        return self._mesh.read_bytes() if self._mesh else None


def _here_or_above(folder: Path, name: str) -> Path:
    """The file of that name in the folder, else in its parent."""
    above = folder.parent / name
    return above if above.is_file() and not (folder / name).is_file() else folder / name


def _read_camera(path: Path) -> tuple[Camera, float]:
    """The camera, and the depth images' units per metre."""
    try:
        params = read_json(path)["camera"]
        # Replica's cx of 599.5 at a width of 1200 counts pixel centres as whole numbers.
        fx, fy, cx, cy, depth_per_m, width, height = (
            float(params[key]) for key in ("fx", "fy", "cx", "cy", "scale", "w", "h")
        )
        camera = Camera.from_integer_centres(int(width), int(height), fx, fy, cx, cy)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProgroundError(
            f"does not describe the camera ({error!r})",
            where=path,
            todo='it needs {"camera": {w, h, fx, fy, cx, cy, scale}}, all numbers',
        ) from error
    if not (np.isfinite([fx, fy, cx, cy, depth_per_m]).all() and min(fx, fy, depth_per_m) > 0):
        raise ProgroundError(
            "its numbers have to be finite, and fx, fy and scale above 0",
            where=path,
            todo="mend the file",
        )
    return camera, depth_per_m
