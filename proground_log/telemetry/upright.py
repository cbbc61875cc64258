"""Which way is up: neither logs nor poses say so, but cameras are seldom held upside down."""

from __future__ import annotations

import numpy as np
import rerun as rr

VIEW_COORDINATES = {
    (0, 1): rr.ViewCoordinates.RIGHT_HAND_X_UP,
    (0, -1): rr.ViewCoordinates.RIGHT_HAND_X_DOWN,
    (1, 1): rr.ViewCoordinates.RIGHT_HAND_Y_UP,
    (1, -1): rr.ViewCoordinates.RIGHT_HAND_Y_DOWN,
    (2, 1): rr.ViewCoordinates.RIGHT_HAND_Z_UP,
    (2, -1): rr.ViewCoordinates.RIGHT_HAND_Z_DOWN,
}
"""Rerun's world axes by the axis that points up, and by its sign."""


def up_axis(world_from_camera: np.ndarray) -> tuple[int, int]:
    """The world's axis nearest to the camera's own up, and its sign.

    Args:
        world_from_camera: a pose, [4, 4], camera axes x right, y down, z forward.
    """
    up = -world_from_camera[:3, 1]
    axis = int(np.abs(up).argmax())
    return axis, 1 if up[axis] > 0 else -1


def up_vector(world_from_camera: np.ndarray) -> tuple[float, float, float]:
    """The direction of `up_axis`."""
    axis, sign = up_axis(world_from_camera)
    x, y, z = (float(sign) if i == axis else 0.0 for i in range(3))
    return x, y, z
