"""Axes of other houses, brought to ours: x right, y down, z forward."""

from __future__ import annotations

import numpy as np


def opencv_from_opengl(world_from_camera: np.ndarray) -> np.ndarray:
    """A pose [4, 4] of a camera with x right, y up, z back, as a pose of one with our axes.

    The world's axes stay as they are.
    """
    return world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
