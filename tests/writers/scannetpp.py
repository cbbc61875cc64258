"""Writes scannetpp data as its public description has it."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import lz4.block
import numpy as np

from proground_log.camera import Camera
from proground_log.frame import SensorFrame
from recorders.formats.scannetpp_depth import HEIGHT, WIDTH
from recorders.reading.images import encoded_png


def record(data: bytes) -> bytes:
    return len(data).to_bytes(4, "little") + data


def lz4_records(frames: Iterable[SensorFrame]) -> bytes:
    pack = lz4.block.compress
    return b"".join(record(pack(f.depth.astype("<u2").tobytes(), store_size=False)) for f in frames)


def write_video(path: Path, frames: Iterable[SensorFrame]) -> None:
    """A film that loses nothing, so that pixels can be compared."""
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 60, (320, 240)
    )
    for frame in frames:
        writer.write(frame.decode_color()[..., ::-1])
    writer.release()


def poses_of(frames: Sequence[SensorFrame], camera: Camera) -> dict[str, Any]:
    """pose_intrinsic_imu.json by the data set's documentation, one frame after the other."""
    return {
        f"frame_{number:06d}": {
            "timestamp": 8123.5 + number / 64,
            "pose": np.eye(4).tolist(),
            "aligned_pose": frame.world_from_camera.tolist(),
            "intrinsic": [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]],
            "imu": {"rotate_rate": [0, 0, 0]},
        }
        for number, frame in enumerate(frames)
    }


def iphone_frame(frame: SensorFrame) -> SensorFrame:
    """The frame as ScanNet++ keeps it."""
    return replace(
        frame,
        depth=cv2.resize(frame.depth, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST),
        color=encoded_png(frame.decode_color()),
        color_format="png",
    )


def write_iphone(folder: Path, frames: Sequence[SensorFrame], poses: dict[str, Any]) -> Path:
    folder.mkdir(parents=True)
    write_video(folder / "rgb.mkv", frames)
    (folder / "depth.bin").write_bytes(lz4_records(frames))
    (folder / "pose_intrinsic_imu.json").write_text(json.dumps(poses))
    return folder


def deflate(data: bytes) -> bytes:
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    return packer.compress(data) + packer.flush()


def metres(frame: SensorFrame) -> bytes:
    return frame.depth_m.astype("<f4").tobytes()


def deflate_records(frames: Iterable[SensorFrame]) -> bytes:
    return b"".join(record(deflate(metres(frame))) for frame in frames)


def one_deflate(frames: Iterable[SensorFrame]) -> bytes:
    return deflate(b"".join(map(metres, frames)))


CODINGS = {"lz4": lz4_records, "deflate": deflate_records, "one stream": one_deflate}
