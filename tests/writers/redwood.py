"""Writes redwood data as its public description has it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from proground_log.frame import SensorFrame

INTRINSIC = {
    "width": 320,
    "height": 240,
    # By columns; Open3D counts pixel centres as whole numbers.
    "intrinsic_matrix": [200.0, 0.0, 0.0, 0.0, 200.0, 0.0, 159.5, 119.5, 1.0],
}


def write_log(path: Path, poses: list[np.ndarray], first: int = 0) -> None:
    blocks = []
    for number, pose in enumerate(poses, start=first):
        rows = "\n".join(" ".join(repr(float(x)) for x in row) for row in pose)
        blocks.append(f"{number} {number} {number + 1}\n{rows}\n")
    path.write_text("".join(blocks))


def write_sequence(
    folder: Path, frames: list[SensorFrame], *, colors: str = "color", timed: bool = False
) -> None:
    """Write the room's frames as Open3D (%05d) or as Redwood's scans (number-microseconds)."""
    for name in (colors, "depth"):
        (folder / name).mkdir(parents=True)
    for number, frame in enumerate(frames):
        microseconds = 33_333 * number
        color_name, depth_name = (
            f"{number + 1:07d}-{at:012d}" if timed else f"{number:05d}"
            for at in (microseconds + 4_000, microseconds)
        )
        (folder / colors / f"{color_name}.jpg").write_bytes(frame.color)
        cv2.imwrite(str(folder / f"depth/{depth_name}.png"), frame.depth)
    write_log(folder / "trajectory.log", [frame.world_from_camera for frame in frames])
    (folder / "camera_intrinsic.json").write_text(json.dumps(INTRINSIC))
