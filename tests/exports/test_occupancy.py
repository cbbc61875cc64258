"""A floor plan as ROS map_server reads it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from proground_log.exports.occupancy import image_of, write_occupancy
from proground_log.navigation.floor_plan import FREE, OCCUPIED, UNKNOWN, FloorPlan
from proground_log.navigation.ground import Ground


def served(path: Path) -> tuple[np.ndarray, dict[str, object]]:
    """What map_server makes of the files, by its public rule: int [H, W], row 0 at the least y."""
    about = yaml.safe_load(path.read_text())
    header = re.match(rb"P5\s+(\d+)\s+(\d+)\s+255\s", (content := image_of(path).read_bytes()))
    assert header is not None
    assert about["image"] == image_of(path).name
    width, height = int(header[1]), int(header[2])
    pixels = np.frombuffer(content[header.end() :], np.uint8).reshape(height, width)
    occupied = (255 - pixels) / 255.0
    assert not about["negate"]
    cells = np.full(pixels.shape, -1)
    cells[occupied > about["occupied_thresh"]] = 100
    cells[occupied < about["free_thresh"]] = 0
    return cells[::-1], about


def plan_of(cells: np.ndarray, rotation: np.ndarray, floor_m: float) -> FloorPlan:
    return FloorPlan(Ground(rotation, floor_m), np.array([-1.5, 2.25]), 0.05, cells)


def test_cells_and_places_survive(tmp_path: Path) -> None:
    path = tmp_path / "floor: 1.yaml"
    cells = np.array([[FREE, OCCUPIED, FREE], [UNKNOWN, FREE, OCCUPIED]], np.uint8)
    write_occupancy(path, plan_of(cells, np.eye(3), 0.0))
    grid, about = served(path)
    meaning = {UNKNOWN: -1, FREE: 0, OCCUPIED: 100}
    for x in range(2):
        for y in range(3):
            assert grid[y, x] == meaning[int(cells[x, y])]
    assert about["origin"] == [-1.5, 2.25, 0.0]
    assert about["resolution"] == 0.05


def test_the_comment_takes_the_world_to_the_grid(tmp_path: Path) -> None:
    path = tmp_path / "floor.yaml"
    # y points down: x of the plan is the world's z, y of the plan its x.
    rotation = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    rotation = rotation * np.linalg.det(rotation)
    plan = plan_of(np.full((2, 2), FREE, np.uint8), rotation, floor_m=-1.2)
    write_occupancy(path, plan)
    comment = path.read_text().splitlines()[0].removeprefix("# grid_from_world: ")
    grid_from_world = np.array(json.loads(comment))
    place_m = np.array([0.3, -0.7])
    at = grid_from_world @ [*plan.ground.world(place_m), 1.0]
    np.testing.assert_allclose(at, [*place_m, 0.0, 1.0], atol=1e-6)
    above = grid_from_world @ [*plan.ground.world(place_m, height_m=0.5), 1.0]
    assert above[2] == pytest.approx(0.5)
