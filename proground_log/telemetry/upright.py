"""Which way is up in the viewer, and from where to look."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from proground_log.mapping.boxes import upright_from_world

VIEW_COORDINATES = {
    (0, 1): rr.ViewCoordinates.RIGHT_HAND_X_UP,
    (0, -1): rr.ViewCoordinates.RIGHT_HAND_X_DOWN,
    (1, 1): rr.ViewCoordinates.RIGHT_HAND_Y_UP,
    (1, -1): rr.ViewCoordinates.RIGHT_HAND_Y_DOWN,
    (2, 1): rr.ViewCoordinates.RIGHT_HAND_Z_UP,
    (2, -1): rr.ViewCoordinates.RIGHT_HAND_Z_DOWN,
}
"""By the world's axis that points up, and its sign."""
BACK, ABOVE = 0.75, 0.7
"""Where the eye stands, from the middle of the place, in its largest extents."""


def overview(vertices_m: np.ndarray, up: np.ndarray) -> rrb.EyeControls3D:
    """An eye that looks into a place from outside, from above.

    Walls and ceilings in between do not hide it, since surfaces are not drawn from behind.

    Args:
        vertices_m: [V, 3], of the place, at least one.
        up: the world's upward direction [3].
    """
    upright = upright_from_world(up)
    places_m = vertices_m @ upright.T
    lower_m, upper_m = places_m.min(axis=0), places_m.max(axis=0)
    middle_m, extent_m = (lower_m + upper_m) / 2, float((upper_m - lower_m).max())
    eye_m = middle_m + extent_m * np.array([0, -BACK, ABOVE])
    return rrb.EyeControls3D(position=eye_m @ upright, look_target=middle_m @ upright, eye_up=up)
