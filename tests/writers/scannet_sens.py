"""Writes scannet sens data as its public description has it."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from proground_log.camera import Camera
from proground_log.frame import SensorFrame
from recorders.room import RoomSource

FIRST_US = 1_467_000_000_123_457


PERIOD_US = 33_334


LOST = np.full((4, 4), -np.inf)


def intrinsic_of(camera: Camera) -> np.ndarray:
    """4x4, as ScanNet has it."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.k_integer_centres
    return matrix


def sens_header(
    color: Camera,
    depth: Camera,
    count: int,
    *,
    extrinsics: tuple[np.ndarray, np.ndarray] | None = None,
    codings: tuple[int, int] = (2, 1),
    depth_per_m: float = 1000.0,
    version: int = 4,
    name: bytes = b"StructureSensor",
) -> bytes:
    """Everything before the first frame."""
    of_color, of_depth = extrinsics or (np.eye(4), np.eye(4))
    matrices = (intrinsic_of(color), of_color, intrinsic_of(depth), of_depth)
    return (
        struct.pack("<IQ", version, len(name))
        + name
        + b"".join(matrix.astype("<f4").tobytes() for matrix in matrices)
        + struct.pack("<ii", *codings)
        + struct.pack("<4I", color.width, color.height, depth.width, depth.height)
        + struct.pack("<fQ", depth_per_m, count)
    )


def sens_frame(
    pose: np.ndarray, color: bytes, depth: bytes, color_us: int = 0, depth_us: int = 0
) -> bytes:
    sizes = struct.pack("<4Q", color_us, depth_us, len(color), len(depth))
    return pose.astype("<f4").tobytes() + sizes + color + depth


def room_sens(
    path: Path, room: RoomSource, frames: Sequence[SensorFrame], *, period_us: int = PERIOD_US
) -> Path:
    """Write frames of the room as ScanNet would: JPEG and zlib, colour 5 ms before depth."""
    camera = room.calibration.depth
    content = sens_header(room.calibration.color, camera, len(frames))
    for number, frame in enumerate(frames):
        depth_us = FIRST_US + number * period_us
        depth = zlib.compress(frame.depth.astype("<u2").tobytes())
        content += sens_frame(
            frame.world_from_camera, frame.color, depth, depth_us - 5000, depth_us
        )
    # Measurements of the inertial sensor come last: none.
    path.write_bytes(content + struct.pack("<Q", 0))
    return path


SMALL = Camera.from_integer_centres(16, 12, 14.0, 15.0, 7.5, 5.25)


WIDE = Camera.from_integer_centres(20, 14, 18.0, 19.0, 9.75, 6.5)


def small_sens(
    path: Path, count: int = 3, codings: tuple[int, int] = (2, 1), **changes: object
) -> Path:
    """A file of noise with another size of colour than of depth."""
    rng = np.random.default_rng(3)
    content = sens_header(WIDE, SMALL, count, codings=codings, **changes)  # type: ignore[arg-type]
    for number in range(count):
        pixels = rng.integers(0, 256, (14, 20, 3), dtype=np.uint8)
        color = pixels.tobytes()
        if codings[0]:
            suffix = {1: ".png", 2: ".jpg"}.get(codings[0], ".png")
            color = cv2.imencode(suffix, pixels)[1].tobytes()
        depth = rng.integers(0, 9000, (12, 16)).astype("<u2").tobytes()
        depth = zlib.compress(depth) if codings[1] else depth
        time_us = 1000 + number * PERIOD_US
        content += sens_frame(np.eye(4), color, depth, time_us, time_us)
    path.write_bytes(content)
    return path
