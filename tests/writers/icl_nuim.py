"""Writes icl nuim data as its public description has it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from proground_log.camera import quaternion_from_pose
from proground_log.frame import SensorFrame

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def published(frame: SensorFrame) -> np.ndarray:
    """The pose that ICL-NUIM's renderer would have had: y up in camera and world."""
    return MIRROR @ frame.world_from_camera @ MIRROR


def freiburg(frames: list[SensorFrame], first: int) -> str:
    lines = []
    for number, frame in enumerate(frames, start=first):
        pose = published(frame)
        numbers = [*pose[:3, 3], *quaternion_from_pose(pose)]
        lines.append(" ".join([str(number), *(repr(float(x)) for x in numbers)]))
    return "\n".join(lines) + "\n"


def write_trajectory(folder: Path, frames: list[SensorFrame]) -> None:
    """Write frames 0, 1, ... of which the first lacks a pose, as the living room's do."""
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    for number, frame in enumerate(frames):
        # The archives have PNG; the recorder keeps whatever bytes there are.
        (folder / f"rgb/{number}.png").write_bytes(frame.color)
        cv2.imwrite(str(folder / f"depth/{number}.png"), frame.depth * np.uint16(5))
    lines = [f"{n} depth/{n}.png {n} rgb/{n}.png" for n in range(len(frames))]
    # Order is by number: 10 after 9, and whatever the lines' order.
    (folder / "associations.txt").write_text("\n".join(reversed(lines)) + "\n")
    (folder / "livingRoom2.gt.freiburg").write_text(freiburg(frames[1:], first=1))
