"""Writes arkitscenes data as its public description has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.camera import Camera
from proground_log.frame import SensorFrame

VIDEO = "40753679"


START_S = 6845


SMALL = (160, 120)


def png(pixels: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", pixels)[1].tobytes())


def stamp(number: int, shift_ms: int = 0) -> str:
    """Seconds as in the names, at 10 frames a second."""
    ms = START_S * 1000 + 100 * number + shift_ms
    return f"{ms // 1000}.{ms % 1000:03d}"


def small_frame(frame: SensorFrame) -> SensorFrame:
    """The frame as ARKitScenes keeps it: PNG colour, depth in fewer pixels."""
    depth = cv2.resize(frame.depth, SMALL, interpolation=cv2.INTER_NEAREST)
    color = png(np.ascontiguousarray(frame.decode_color()[..., ::-1]))
    return replace(frame, depth=depth, color=color, color_format="png")


def write_video(folder: Path, frames: Sequence[SensorFrame], camera: Camera) -> None:
    """Write a video by DATA.md: the names' times in the folders differ by a millisecond."""
    lines = []
    for name in ("lowres_wide", "lowres_depth", "confidence", "lowres_wide_intrinsics"):
        (folder / name).mkdir(parents=True)
    for number, frame in enumerate(frames):
        at = f"{VIDEO}_{stamp(number)}"
        (folder / f"lowres_wide/{at}.png").write_bytes(frame.color)
        (folder / f"lowres_depth/{at}.png").write_bytes(png(frame.depth))
        confidence = np.full(frame.depth.shape, 2, np.uint8)
        (folder / f"confidence/{at}.png").write_bytes(png(confidence))
        k = f"{camera.fx + number // 3} {camera.fy} {camera.cx} {camera.cy}"
        shifted = f"{VIDEO}_{stamp(number, shift_ms=number % 3 - 1)}"
        (folder / f"lowres_wide_intrinsics/{shifted}.pincam").write_text(
            f"{camera.width} {camera.height} {k}\n"
        )
        camera_from_world = np.linalg.inv(frame.world_from_camera)
        turn = Rotation.from_matrix(camera_from_world[:3, :3]).as_rotvec()
        numbers = [*turn.tolist(), *camera_from_world[:3, 3].tolist()]
        lines.append(f"{stamp(number)}000 {' '.join(repr(x) for x in numbers)}")
    (folder / "lowres_wide.traj").write_text("\n".join(lines) + "\n")
