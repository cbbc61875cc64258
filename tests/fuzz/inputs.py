"""Small valid inputs, by the writers of the formats' own tests.

Each function writes into an empty folder and returns what is to be opened, or makes one that does.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType

from proground_log.camera import Camera
from proground_log.frame import SensorFrame
from recorders.formats.scannetpp_depth import HEIGHT, WIDTH
from tests.evaluation.labelled_ply import ply
from tests.writers import (
    arkitscenes,
    colmap,
    nerfstudio,
    record3d,
    redwood,
    ros1_bag,
    scannet_sens,
    scannetpp,
    tum,
)
from tests.writers.ros_bags import room_messages, write_mcap
from tests.writers.small_source import CAMERA, SmallSource, write_log

FRAMES = 3


def _frames(color_format: str = "jpeg", count: int = FRAMES) -> list[SensorFrame]:
    source = SmallSource(count, color_format=color_format)
    # Those of the tests' writers begin at zero.
    return [
        replace(frame, stamp_ns=frame.stamp_ns % 10**9, color_stamp_ns=frame.color_stamp_ns % 10**9)
        for frame in map(source.frame, range(count))
    ]


def sens(codings: tuple[int, int]) -> Callable[[Path], Path]:
    return lambda folder: scannet_sens.small_sens(folder / "a.sens", codings=codings)


def r3d(folder: Path) -> Path:
    frames = _frames()
    metadata = record3d.metadata_of(frames, CAMERA)
    return record3d.write_zip(folder / "a.r3d", record3d.members_of(frames), metadata)


def iphone(coding: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        frames = [
            replace(frame, depth=np.kron(frame.depth, np.ones((8, 8), np.uint16)))
            for frame in _frames()
        ]
        assert frames[0].depth.shape == (HEIGHT, WIDTH)
        video = cv2.VideoWriter(
            str(folder / "rgb.mkv"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 60, (32, 24)
        )
        for frame in frames:
            video.write(frame.decode_color())
        video.release()
        (folder / "depth.bin").write_bytes(scannetpp.CODINGS[coding](frames))
        poses = scannetpp.poses_of(frames, CAMERA)
        (folder / "pose_intrinsic_imu.json").write_text(json.dumps(poses))
        return folder

    return write


def workspace(
    write_model: Callable[[Path, list[SensorFrame], Camera], None],
) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        frames = _frames(count=len(colmap.NAMES))
        (folder / "images").mkdir()
        for name, frame in zip(colmap.NAMES, frames, strict=True):
            (folder / "images" / name).write_bytes(frame.color)
        write_model(folder / "sparse", frames, CAMERA)
        colmap.write_depth_maps(folder, frames, "geometric")
        return folder

    return write


def bag(depth: str, color: str, compression: CompressionType) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        sent = room_messages(_frames(), CAMERA, color=color, depth=depth)
        return write_mcap(folder / "a.mcap", sent, compression=compression)

    return write


def old_bag(compression: str | None) -> Callable[[Path], Path]:
    return lambda folder: ros1_bag.write_bag(
        folder / "a.bag", room_messages(_frames(), CAMERA), compression
    )


def log(folder: Path) -> Path:
    return write_log(folder / "a.mcap", SmallSource(FRAMES, with_labels=True))


def transforms(folder: Path) -> Path:
    entries = {"fl_x": 30.0, "fl_y": 30.0, "cx": 16.0, "cy": 12.0, "w": 32, "h": 24}
    nerfstudio.write_data_set(folder, _frames(), **entries)
    return folder


def depth_npy(folder: Path) -> Path:
    transforms(folder)
    content = json.loads((folder / "transforms.json").read_text())
    for number, frame in enumerate(content["frames"]):
        depth = np.full((24, 32), number + 1.5, np.float32)
        np.save(folder / f"depths/{number}.npy", depth)
        frame["depth_file_path"] = f"depths/{number}.npy"
    nerfstudio.write(folder, content)
    return folder


def tum_folder(folder: Path) -> Path:
    tum.write_sequence(folder / "a")
    return folder / "a"


def redwood_folder(folder: Path) -> Path:
    redwood.write_sequence(folder, _frames())
    matrix = [30.0, 0.0, 0.0, 0.0, 30.0, 0.0, 15.5, 11.5, 1.0]
    camera = {"width": 32, "height": 24, "intrinsic_matrix": matrix}
    (folder / "camera_intrinsic.json").write_text(json.dumps(camera))
    return folder


def arkitscenes_video(folder: Path) -> Path:
    frames = [replace(f, depth=f.depth[::2, ::2]) for f in _frames("png")]
    arkitscenes.write_video(folder / arkitscenes.VIDEO, frames, CAMERA)
    return folder / arkitscenes.VIDEO


def mesh(order: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / "a.ply").write_bytes(ply(order))
        return folder / "a.ply"

    return write
