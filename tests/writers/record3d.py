"""Writes record3d data as its public description has it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np
import pytest

from proground_log.camera import Camera, quaternion_from_pose
from proground_log.frame import SensorFrame

lzfse = pytest.importorskip("lzfse")


OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def metadata_of(frames: Sequence[SensorFrame], camera: Camera) -> dict[str, Any]:
    """The metadata of a recording, by the description in Record3D's issues 27, 33, 83 and 99."""
    poses = [frame.world_from_camera @ OPENGL_FROM_OPENCV for frame in frames]
    return {
        "w": camera.width,
        "h": camera.height,
        "dw": frames[0].depth.shape[1],
        "dh": frames[0].depth.shape[0],
        "fps": 60,
        "K": [camera.fx, 0, 0, 0, camera.fy, 0, camera.cx, camera.cy, 1],
        "poses": [[*quaternion_from_pose(p).tolist(), *p[:3, 3].tolist()] for p in poses],
        "initPose": [0, 0, 0, 1, 0, 0, 0],
    }


def members_of(frames: Sequence[SensorFrame]) -> dict[str, bytes]:
    members = {"icon": b"thumbnail"}
    for number, frame in enumerate(frames):
        depth_m = np.ascontiguousarray(frame.depth_m, dtype="<f4")
        members[f"rgbd/{number}.jpg"] = frame.color
        members[f"rgbd/{number}.depth"] = lzfse.compress(depth_m.tobytes())
        members[f"rgbd/{number}.conf"] = lzfse.compress(bytes([2]) * depth_m.size)
    return members


def write_zip(path: Path, members: dict[str, bytes], metadata: Any) -> Path:
    with ZipFile(path, "w") as archive:
        # Record3D's own order: whatever comes first, numbers decide.
        for name, data in sorted(members.items(), reverse=True):
            archive.writestr(ZipInfo(name), data)
        text = metadata if isinstance(metadata, str) else json.dumps(metadata)
        archive.writestr(ZipInfo("metadata"), text)
    return path
