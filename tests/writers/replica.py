"""Writes replica data as its public description has it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from proground_log.camera import pose_from_quaternion

NUMBERS = (0, 2, 10)


PARAMS = {"w": 32, "h": 24, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5, "scale": 6553.5}


CLASSES = [{"id": 0, "name": "void"}, {"id": 7, "name": "chair"}, {"id": 3, "name": "red lamp"}]


PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\n"
    b"property ushort label\nelement face 0\nend_header\n"
)


def write_scene(scene: Path, *, labels: bool = True) -> dict[int, tuple[np.ndarray, ...]]:
    """Write a small scene; returns depth, labels and pose by frame number."""
    rng = np.random.default_rng(6)
    (scene / "results").mkdir(parents=True)
    (scene / "cam_params.json").write_text(json.dumps({"camera": PARAMS}))
    lines, written = [], {}
    for number in range(max(NUMBERS) + 1):
        quaternion = rng.normal(size=4)
        pose = pose_from_quaternion(rng.normal(size=3), quaternion / np.linalg.norm(quaternion))
        lines.append(" ".join(repr(float(x)) for x in pose.ravel()))
        if number not in NUMBERS:
            continue
        depth = rng.integers(0, 65536, (24, 32), dtype=np.uint16)
        classes = rng.integers(0, 256, (24, 32), dtype=np.uint8)
        color = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
        cv2.imwrite(str(scene / f"results/frame{number:06d}.jpg"), color)
        cv2.imwrite(str(scene / f"results/depth{number:06d}.png"), depth)
        if labels:
            (scene / "semantic_class").mkdir(exist_ok=True)
            cv2.imwrite(str(scene / f"semantic_class/semantic_class_{number}.png"), classes)
        written[number] = (depth, classes, pose)
    (scene / "traj.txt").write_text("\n".join(lines) + "\n")
    if labels:
        (scene / "info_semantic.json").write_text(json.dumps({"classes": CLASSES}))
        (scene / "mesh_semantic.ply").write_bytes(PLY)
    return written
