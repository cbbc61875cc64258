"""The camera of a nerfstudio frame: transforms.json describes it once, or frame by frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from proground_log.camera import Camera
from proground_log.errors import ProgroundError

PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
FISHEYE = ("OPENCV_FISHEYE",)
LARGEST_SIZE = 65_535


def read_camera(params: Mapping[str, Any], size: tuple[int, int], *, where: object) -> Camera:
    """The camera that transforms.json describes; principal points count from pixels' corners.

    Args:
        params: the file's own entries and a frame's: `fl_x`, `fl_y` or `camera_angle_x`; `cx`,
            `cy`, else the middle; `w`, `h`; `camera_model`; `k1` to `k4`, `p1`, `p2`.
        size: width and height of the image, where `w` and `h` are missing.
        where: the file and frame, for messages.

    Raises:
        ProgroundError: an entry is missing, no number or out of range, or no such lens is known.
    """
    todo = "it needs fl_x, fl_y, cx, cy, w and h, all numbers, for the file or for each frame"
    model = params.get("camera_model", "OPENCV")
    if model not in PERSPECTIVE + FISHEYE:
        raise ProgroundError(
            f"the camera model {model!r} has no pinhole",
            where=where,
            todo=f"undistort the images; known: {', '.join(PERSPECTIVE + FISHEYE)}",
        )
    try:
        width, height = (
            int(float(params.get(key, each))) for key, each in zip("wh", size, strict=True)
        )
        fx = _focal_length(params, "x", width)
        fy = _focal_length(params, "y", height) if _has_focal_length(params, "y") else fx
        cx, cy = float(params.get("cx", width / 2)), float(params.get("cy", height / 2))
        k1, k2, k3, k4, p1, p2 = (
            float(params.get(key, 0.0)) for key in ("k1", "k2", "k3", "k4", "p1", "p2")
        )
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise ProgroundError(
            f"does not describe the camera ({error!r})", where=where, todo=todo
        ) from error
    numbers = (fx, fy, cx, cy, k1, k2, k3, k4, p1, p2)
    sizes_fit = all(1 <= each <= LARGEST_SIZE for each in (width, height))
    if not (all(map(math.isfinite, numbers)) and min(fx, fy) > 0 and sizes_fit):
        raise ProgroundError(
            "sizes and focal lengths have to be above 0, and numbers finite", where=where, todo=todo
        )
    if model in FISHEYE:
        return Camera(width, height, fx, fy, cx, cy, (k1, k2, k3, k4))
    if k4 != 0:
        raise ProgroundError(
            "has k4, a term that no lens of OpenCV has", where=where, todo="undistort the images"
        )
    distortion = (k1, k2, p1, p2, k3)
    return Camera(width, height, fx, fy, cx, cy, distortion if any(distortion) else ())


def _has_focal_length(params: Mapping[str, Any], axis: str) -> bool:
    return f"fl_{axis}" in params or f"camera_angle_{axis}" in params


def _focal_length(params: Mapping[str, Any], axis: str, size: int) -> float:
    """In pixels; Blender's files have the angle of view instead, in radians."""
    if f"fl_{axis}" in params or f"camera_angle_{axis}" not in params:
        return float(params[f"fl_{axis}"])
    return 0.5 * size / math.tan(0.5 * float(params[f"camera_angle_{axis}"]))
