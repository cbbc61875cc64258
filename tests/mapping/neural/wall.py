"""What tests of online mapper share."""

from __future__ import annotations

import numpy as np

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.frame import Frame

CAMERA = Camera(40, 30, 30.0, 30.0, 20.0, 15.0)


BOUNDS = Bounds((-2.0, -1.5, 0.0), (2.0, 1.5, 2.5))


WALL_M = 2.0


def wall_frame(index: int, shift_m: float = 0.0) -> Frame:
    """Red left of x = 0, green right of it; the camera looks along z from (shift, 0, 0)."""
    pose = np.eye(4)
    pose[0, 3] = shift_m
    x_m = CAMERA.directions[..., 0] * WALL_M + shift_m
    color = np.zeros((30, 40, 3), np.uint8)
    color[x_m < 0, 0] = 200
    color[x_m >= 0, 1] = 200
    depth_m = np.full((30, 40), WALL_M, np.float32)
    valid = np.ones((30, 40), bool)
    return Frame(index, index * 10**8, CAMERA, pose, depth_m, color, valid, None)
