"""Writes hm3dsem walk data as its public description has it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from proground_log.frame import SensorFrame

SCENE = "Dd4bFSTQ8gi"


def write_walk(walk: Path, frames: Sequence[SensorFrame], *, truth: bool = True) -> Path:
    """Write frames of the room as HOV-SG's script renders a walk; colour is PNG there."""
    for name in ("rgb", "depth", "pose", *(("semantic",) if truth else ())):
        (walk / name).mkdir(parents=True)
    for number, frame in enumerate(frames):
        name = f"{SCENE}_{number:06}"
        cv2.imwrite(str(walk / f"rgb/{name}.png"), frame.decode_color()[..., ::-1])
        cv2.imwrite(str(walk / f"depth/{name}.png"), frame.depth)
        pose = frame.world_from_camera.copy()
        pose[:, 1:3] *= -1
        (walk / f"pose/{name}.txt").write_text("\t".join(str(x) for x in pose.flatten()) + "\n")
        if truth:
            assert frame.instances is not None
            np.save(walk / f"semantic/{name}.npy", frame.instances.astype(np.uint32))
    return walk
