"""Writes nerfstudio data as its public description has it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from proground_log.frame import SensorFrame

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


INTRINSICS = {
    "fl_x": 200.0, "fl_y": 200.0, "cx": 160.0, "cy": 120.0, "w": 320, "h": 240
}  # fmt: skip


def write_data_set(folder: Path, frames: list[SensorFrame], **entries: Any) -> dict[str, Any]:
    """Write the room's frames by nerfstudio's description, the last first; returns the JSON."""
    listed = []
    for number, frame in reversed(list(enumerate(frames, start=8))):
        for name, data in (
            (f"images/frame_{number}.jpg", frame.color),
            (f"depths/frame_{number}.png", cv2.imencode(".png", frame.depth)[1].tobytes()),
        ):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        listed.append(
            {
                "file_path": f"./images/frame_{number}.jpg",
                "depth_file_path": f"depths/frame_{number}.png",
                "transform_matrix": (frame.world_from_camera @ OPENGL_FROM_OPENCV).tolist(),
            }
        )
    content = {"camera_model": "OPENCV", **INTRINSICS, "frames": listed, **entries}
    write(folder, content)
    return content


def write(folder: Path, content: Any) -> None:
    (folder / "transforms.json").write_text(json.dumps(content))
