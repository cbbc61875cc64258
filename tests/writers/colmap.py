"""Writes colmap data as its public description has it."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

from proground_log.camera import Camera, quaternion_from_pose, transform
from proground_log.frame import SensorFrame

METRES_PER_UNIT = 0.25


NUMBERS = (0, 2, 3, 9, 10, 11)


NAMES = [f"frame-{number}.jpg" for number in NUMBERS]


IDS = {"PINHOLE": 1, "OPENCV": 4}


Observation = tuple[float, float, int]


def model_of(
    frames: list[SensorFrame], camera: Camera
) -> tuple[list[tuple[float, ...]], list[tuple[np.ndarray, list[Observation]]]]:
    """Points in units, and by image the pose camera_from_world and what it sees of them."""
    rng = np.random.default_rng(5)
    points: list[tuple[float, ...]] = []
    images: list[tuple[np.ndarray, list[Observation]]] = []
    for frame in frames:
        rows, columns = rng.integers(0, frame.depth.shape, (60, 2)).T
        depth = frame.depth_m[rows, columns]
        xy = camera.pinhole().directions[rows, columns].astype(np.float64)
        seen = xy[depth > 0] * depth[depth > 0, None]
        pixels = camera.project(seen)
        world = transform(frame.world_from_camera, seen) / METRES_PER_UNIT
        pose = np.linalg.inv(frame.world_from_camera)
        pose[:3, 3] /= METRES_PER_UNIT
        first = len(points) + 7  # numbers of points are arbitrary
        ids = range(first, first + len(world))
        observations = [(float(x), float(y), i) for (x, y), i in zip(pixels, ids, strict=True)]
        points += [tuple(point) for point in world.tolist()]
        images.append((pose, [(1.5, 2.5, -1), *observations]))
    return points, images


def quaternion_wxyz(pose: np.ndarray) -> list[float]:
    return np.roll(quaternion_from_pose(pose), 1).tolist()


def lens(camera: Camera) -> tuple[str, list[float]]:
    params = [camera.fx, camera.fy, camera.cx, camera.cy]
    if camera.distortion:
        return "OPENCV", [*params, *camera.distortion[:4]]
    return "PINHOLE", params


def write_binary(folder: Path, frames: list[SensorFrame], camera: Camera) -> None:
    """The classic three files, by COLMAP's page on its output format."""
    folder.mkdir(parents=True)
    points, images = model_of(frames, camera)
    name, params = lens(camera)
    data = struct.pack("<QIiQQ", 1, 3, IDS[name], camera.width, camera.height)
    (folder / "cameras.bin").write_bytes(data + struct.pack(f"<{len(params)}d", *params))
    data = struct.pack("<Q", len(images))
    for index in (3, 0, 5, 1, 2, 4):
        pose, seen = images[index]
        data += struct.pack("<I7dI", index + 1, *quaternion_wxyz(pose), *pose[:3, 3], 3)
        data += NAMES[index].encode() + b"\0" + struct.pack("<Q", len(seen))
        data += b"".join(struct.pack("<ddq", *each) for each in seen)
    (folder / "images.bin").write_bytes(data)
    tracks = tracks_of(images)
    data = struct.pack("<Q", len(points))
    for key, point in enumerate(points, start=7):
        data += struct.pack("<Q3d3Bd", key, *point, 1, 2, 3, 0.5)
        data += struct.pack("<QII", 1, *tracks[key])
    (folder / "points3D.bin").write_bytes(data)


def write_text(folder: Path, frames: list[SensorFrame], camera: Camera) -> None:
    """The same as text."""
    folder.mkdir(parents=True)
    points, images = model_of(frames, camera)
    name, params = lens(camera)
    columns = (3, name, camera.width, camera.height, *params)
    text = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" + " ".join(map(str, columns))
    (folder / "cameras.txt").write_text(text + "\n")
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[]"]
    for index, (pose, seen) in enumerate(images):
        columns = (index + 1, *quaternion_wxyz(pose), *pose[:3, 3].tolist(), 3, NAMES[index])
        lines.append(" ".join(map(str, columns)))
        lines.append(" ".join(f"{x!r} {y!r} {key}" for x, y, key in seen))
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    tracks = tracks_of(images)
    lines = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]"]
    for key, point in enumerate(points, start=7):
        columns = (key, *point, 1, 2, 3, 0.5, *tracks[key])
        lines.append(" ".join(map(str, columns)))
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")


def tracks_of(images: list[tuple[np.ndarray, list[Observation]]]) -> dict[int, tuple[int, int]]:
    return {
        key: (image_id, at)
        for image_id, (_, seen) in enumerate(images, start=1)
        for at, (*_, key) in enumerate(seen)
        if key >= 0
    }


def write_workspace(folder: Path, frames: list[SensorFrame], camera: Camera) -> Path:
    """Images, a binary model in sparse/0 and, aside, depth in sensor/."""
    for name in ("images", "sensor"):
        (folder / name).mkdir(parents=True)
    for number, name, frame in zip(NUMBERS, NAMES, frames, strict=True):
        (folder / "images" / name).write_bytes(frame.color)
        cv2.imwrite(str(folder / f"sensor/{number:04d}-depth.png"), frame.depth)
    write_binary(folder / "sparse/0", frames, camera)
    return folder


def write_depth_maps(
    workspace: Path, frames: list[SensorFrame], kind: str, factor: float = 1.0
) -> None:
    """What patch match writes, with a few of its invalid values."""
    folder = workspace / "stereo/depth_maps"
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in zip(NAMES, frames, strict=True):
        depth = frame.depth_m * np.float32(factor / METRES_PER_UNIT)
        depth[frame.depth == 0] = [-1.0, 0.0, np.nan][len(name) % 3]
        height, width = depth.shape
        header = f"{width}&{height}&1&".encode()
        (folder / f"{name}.{kind}.bin").write_bytes(header + depth.astype("<f4").tobytes())
