"""Rerun's names for worlds by the axis that points up."""

from __future__ import annotations

import rerun as rr

VIEW_COORDINATES = {
    (0, 1): rr.ViewCoordinates.RIGHT_HAND_X_UP,
    (0, -1): rr.ViewCoordinates.RIGHT_HAND_X_DOWN,
    (1, 1): rr.ViewCoordinates.RIGHT_HAND_Y_UP,
    (1, -1): rr.ViewCoordinates.RIGHT_HAND_Y_DOWN,
    (2, 1): rr.ViewCoordinates.RIGHT_HAND_Z_UP,
    (2, -1): rr.ViewCoordinates.RIGHT_HAND_Z_DOWN,
}
"""By the world's axis that points up, and its sign."""
