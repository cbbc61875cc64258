"""The floor plan as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from proground_log.navigation.picture import GOAL, START, WAY, Sight, draw_route
from proground_log.navigation.planner import Planner
from tests.navigation.scenes import plan_of, scene


def test_the_picture_shows_the_way_and_is_the_same_each_time(tmp_path: Path) -> None:
    plan = plan_of(scene((4.0, 3.0), [((1.5, 1.0, 0.0), (2.5, 2.0, 0.9))]))
    planner = Planner(plan, np.array([0.5, 1.5]), 0.18)
    route = planner.to_place(np.array([3.5, 1.5]))
    sight = Sight("a $box", np.array([(1.5, 1.0), (2.5, 1.0), (2.5, 2.0), (1.5, 2.0)]))
    contents = []
    for name in ("a.png", "b.png"):
        draw_route(tmp_path / name, plan, planner.graph, route, sight)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]
    pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).reshape(-1, 3).astype(int)
    for color in (WAY, GOAL, START):
        rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        assert (np.abs(pixels - rgb).max(axis=1) < 40).sum() > 100
