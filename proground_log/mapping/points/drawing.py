"""Points of a frame, and points drawn into a view."""

from __future__ import annotations

import numpy as np

from proground_log.camera import Camera, transform
from proground_log.frame import Frame

NEAREST_M = 0.05
MOST_REACH_PX = 8
"""A point covers at most so many pixels to either side, however near it is."""


def frame_points(frame: Frame, stride: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """What a frame saw.

    Args:
        frame: the frame.
        stride: every so many-th pixel each way.

    Returns:
        Points, float64 [N, 3] in world metres, and the flat numbers of their pixels, int64 [N];
        pixels with depth and colour alone.
    """
    known = (frame.depth_m > 0) & frame.color_valid
    thinned = np.zeros_like(known)
    thinned[stride // 2 :: stride, stride // 2 :: stride] = True
    pixels = np.flatnonzero(known & thinned)
    points_m = frame.camera.unproject(frame.depth_m).reshape(-1, 3)[pixels]
    return transform(frame.world_from_camera, points_m.astype(np.float64)), pixels


def draw_points(
    points_m: np.ndarray,
    camera: Camera,
    world_from_camera: np.ndarray,
    radius_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw points as squares that face the camera; the nearest covers those behind it.

    Args:
        points_m: [P, 3], world axes.
        camera: without distortion; the size of the result.
        world_from_camera: pose, float64 [4, 4].
        radius_m: half the side of a square.

    Returns:
        The number of the point at each pixel, int64 [H, W], -1 for none; and its depth along z,
        float32 [H, W] metres, 0 for none. Of points as near the one with the lowest number counts.
    """
    owner = np.full(camera.height * camera.width, -1)
    depth_m = np.full(camera.height * camera.width, np.inf, np.float32)
    seen_m = transform(np.linalg.inv(world_from_camera), points_m.astype(np.float64))
    numbers = np.flatnonzero(seen_m[:, 2] > NEAREST_M)
    # The farthest first, so that what is nearer is drawn over it.
    numbers = numbers[np.lexsort((-numbers, -seen_m[numbers, 2]))]
    columns, rows = np.floor(camera.project(seen_m[numbers])).astype(np.int64).T
    z_m = seen_m[numbers, 2].astype(np.float32)
    reach = np.minimum(radius_m * max(camera.fx, camera.fy) / z_m, MOST_REACH_PX)
    for y in range(-MOST_REACH_PX, MOST_REACH_PX + 1):
        for x in range(-MOST_REACH_PX, MOST_REACH_PX + 1):
            at_column, at_row = columns + x, rows + y
            drawn = (max(abs(x), abs(y)) <= reach) & (at_column >= 0) & (at_row >= 0)
            drawn &= (at_column < camera.width) & (at_row < camera.height)
            pixels = at_row[drawn] * camera.width + at_column[drawn]
            # Of several points at one pixel the last in the order is the nearest.
            last, index = np.unique(pixels[::-1], return_index=True)
            nearest = np.flatnonzero(drawn)[::-1][index]
            closer = z_m[nearest] < depth_m[last]
            ties = (z_m[nearest] == depth_m[last]) & (numbers[nearest] < owner[last])
            closer |= ties
            owner[last[closer]] = numbers[nearest[closer]]
            depth_m[last[closer]] = z_m[nearest[closer]]
    shape = camera.height, camera.width
    return owner.reshape(shape), np.where(np.isinf(depth_m), 0, depth_m).reshape(shape)
