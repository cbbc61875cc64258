"""Writes replica semantic data as its public description has it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from proground_log.frame import SensorFrame
from recorders.reading.images import encoded_png

FIRST = 7
"""The number of the first frame: six from here are out of order as text."""


def semantic_frame(frame: SensorFrame) -> SensorFrame:
    """The frame as this layout has it: PNG, and things with numbers of their own."""
    assert frame.labels is not None
    return replace(
        frame,
        color=encoded_png(frame.decode_color()),
        color_format="png",
        instances=np.where(frame.labels == 0, 0, frame.labels + 300).astype(np.uint16),
    )


def write_sequence(folder: Path, frames: list[SensorFrame], names: dict[int, str]) -> Path:
    for name in ("rgb", "depth", "semantic_class", "semantic_instance"):
        (folder / name).mkdir(parents=True)
    poses = [np.eye(4)] * FIRST
    for number, frame in enumerate(frames, start=FIRST):
        (folder / f"rgb/rgb_{number}.png").write_bytes(frame.color)
        for name, pixels in (
            ("depth/depth", frame.depth),
            ("semantic_class/semantic_class", frame.labels),
            ("semantic_instance/semantic_instance", frame.instances),
        ):
            assert pixels is not None
            assert cv2.imwrite(str(folder / f"{name}_{number}.png"), pixels)
        (folder / f"semantic_class/vis_sem_class_{number}.png").write_bytes(frame.color)
        poses.append(frame.world_from_camera)
    rows = [" ".join(repr(float(x)) for x in pose.ravel()) for pose in poses]
    (folder / "traj_w_c.txt").write_text("\n".join(rows) + "\n")
    info = {
        "classes": [{"id": -1, "name": "undefined"}]
        + [{"id": label, "name": name} for label, name in names.items()],
        "id_to_label": [-1] * 301 + list(range(1, max(names) + 1)) + [-2],
    }
    (folder / "info_semantic.json").write_text(json.dumps(info))
    return folder
