"""Where the viewer's eye stands to look over a place."""

from __future__ import annotations

import numpy as np
import pytest

from proground_log.streams import stream
from proground_log.telemetry.upright import overview


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (0.6, 0, 0.8)])
def test_the_eye_looks_down_into_the_place_from_outside(up: tuple[float, float, float]) -> None:
    vertices_m = stream(0, "place").uniform((-1, 2, 0), (5, 6, 3), (200, 3))
    eye = overview(vertices_m, np.array(up))
    assert eye.position is not None
    assert eye.look_target is not None
    at_m, target_m = (
        np.array(vector.as_arrow_array().to_pylist()[0])
        for vector in (eye.position, eye.look_target)
    )
    assert (target_m > vertices_m.min(axis=0)).all()
    assert (target_m < vertices_m.max(axis=0)).all()
    heights_m = vertices_m @ up
    assert at_m @ up > heights_m.max()
    from_above_m = np.linalg.norm(np.cross(at_m - target_m, up))
    across_m = np.linalg.norm(np.cross(vertices_m - target_m, up), axis=1)
    assert from_above_m > np.median(across_m)
