"""Ways: safe, short, and told apart from no way."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.sparse import lil_array
from scipy.sparse.csgraph import dijkstra

from proground_log.errors import ProgroundError
from proground_log.navigation.floor_plan import FloorPlan
from proground_log.navigation.planner import Planner
from proground_log.navigation.smoothing import dense
from tests.navigation.scenes import Box, distance_m, plan_of, scene

SIZE_M = (5.99, 4.99)
"""Not to the very side of a cell, which would add a row."""
RADIUS_M = 0.18
START_M = np.array([0.5, 0.5])


def furnished(seed: int) -> list[Box]:
    """Boxes anywhere but in the corners."""
    draw = np.random.default_rng(seed)
    boxes: list[Box] = []
    for _ in range(7):
        x_m, y_m = draw.uniform((0.9, 0.9), (4.3, 3.3))
        wide_m, deep_m = draw.uniform(0.2, 0.9, 2)
        boxes.append(((x_m, y_m, 0.0), (x_m + wide_m, y_m + deep_m, 0.9)))
    return boxes


def shortest_m(boxes: list[Box], start_m: np.ndarray, goal_m: np.ndarray) -> float:
    """A bound on the shortest way, by the true distances: a fine grid with sixteen directions."""
    step_m = 0.04
    x, y = np.meshgrid(*(np.arange(0, side, step_m) for side in SIZE_M), indexing="ij")
    places_m = np.stack([x, y], axis=-1)
    fits = distance_m(places_m.reshape(-1, 2), SIZE_M, boxes).reshape(x.shape) >= RADIUS_M
    numbers = np.arange(fits.size).reshape(fits.shape)
    grid = lil_array((fits.size, fits.size))
    for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)):
        beside = np.zeros_like(fits)
        beside[: -di or None, max(0, -dj) : -dj if dj > 0 else None] = fits[
            di:, max(0, dj) : dj if dj < 0 else None
        ]
        here = numbers[fits & beside]
        grid[here, here + di * fits.shape[1] + dj] = step_m * np.hypot(di, dj)
    start, goal = (numbers[tuple(np.rint(p / step_m).astype(int))] for p in (start_m, goal_m))
    length_m = dijkstra(grid.tocsr(), directed=False, indices=start)[goal]
    # Sixteen directions make a way at most 2.8 % longer.
    return float(length_m) / 1.028


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_way_is_safe_by_the_true_distances_and_near_the_shortest(seed: int) -> None:
    boxes = furnished(seed)
    planner = Planner(plan_of(scene(SIZE_M, boxes)), START_M, RADIUS_M)
    for goal in ((5.5, 4.5), (5.5, 0.5), (0.5, 4.5)):
        goal_m = np.array(goal)
        route = planner.to_place(goal_m)
        np.testing.assert_array_equal(route.corners_m[0], START_M)
        np.testing.assert_array_equal(route.corners_m[-1], goal_m)
        assert route.clearance_m.min() >= RADIUS_M - 1e-9
        points_m = dense(route.corners_m, 0.005)
        assert distance_m(points_m, SIZE_M, boxes).min() >= RADIUS_M
        least_m = shortest_m(boxes, START_M, goal_m)
        assert 0.99 * least_m <= route.length_m <= 1.3 * least_m


def test_a_way_across_an_empty_room_is_straight() -> None:
    planner = Planner(plan_of(scene(SIZE_M)), np.array([1.0, 1.0]), RADIUS_M)
    route = planner.to_place(np.array([5.0, 3.7]))
    assert route.length_m == pytest.approx(np.hypot(4.0, 2.7), rel=0.005)
    assert route.turns == 0
    assert route.heading_rad == pytest.approx(np.arctan2(2.7, 4.0), abs=0.1)


def test_where_there_is_room_the_way_leaves_the_wall() -> None:
    planner = Planner(plan_of(scene(SIZE_M)), np.array([0.5, 0.23]), RADIUS_M)
    route = planner.to_place(np.array([5.5, 0.23]))
    assert np.median(route.clearance_m) > 1.6 * RADIUS_M
    assert route.length_m < 1.05 * 5.0


def test_the_same_question_has_the_same_answer() -> None:
    ways = [
        Planner(plan_of(scene(SIZE_M, furnished(0))), START_M, RADIUS_M)
        .to_place(np.array([5.5, 4.5]))
        .corners_m
        for _ in range(2)
    ]
    np.testing.assert_array_equal(*ways)


def test_a_way_to_where_one_is_has_no_length() -> None:
    route = Planner(plan_of(scene(SIZE_M)), START_M, RADIUS_M).to_place(START_M)
    assert route.length_m == 0
    assert route.turns == 0
    assert np.isfinite(route.heading_rad)


CUPBOARD: Box = ((2.0, 2.0, 0.0), (3.0, 2.4, 0.9))


def footprint(box: Box) -> np.ndarray:
    (left, low, _), (right, high, _) = box
    x, y = np.meshgrid(np.linspace(left, right, 30), np.linspace(low, high, 30))
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def test_a_thing_is_reached_beside_it_and_faced() -> None:
    plan = plan_of(scene(SIZE_M, [CUPBOARD]))
    route = Planner(plan, np.array([2.5, 0.6]), RADIUS_M).to_thing(footprint(CUPBOARD), "cupboard")
    x_m, y_m = route.corners_m[-1]
    # Below it, where the start is, and as near as the radius and a cell or two allow.
    assert 1.9 < x_m < 3.1
    assert 2.0 - RADIUS_M - 0.15 < y_m <= 2.0 - RADIUS_M
    assert route.heading_rad == pytest.approx(np.pi / 2, abs=0.3)


def test_a_thing_far_from_the_floor_is_not_reached() -> None:
    bed: Box = ((2.0, 0.0, 0.0), (6.0, 4.9, 0.5))
    plan = plan_of(scene(SIZE_M, [bed]))
    cushion = footprint(((4.5, 2.0, 0.5), (4.9, 2.4, 0.6)))
    with pytest.raises(ProgroundError, match="no floor within 1 m") as fault:
        Planner(plan, START_M, RADIUS_M).to_thing(cushion, "cushion")
    assert "'cushion'" in fault.value.where


WALL: list[Box] = [((3.0, 0.0, 0.0), (3.1, 2.0, 0.9)), ((3.0, 2.3, 0.0), (3.1, 5.0, 0.9))]
"""With a gap of 0.3 m."""
SHUT: list[Box] = [((3.0, 0.0, 0.0), (3.1, 5.0, 0.9))]
GAP_FLOOR: list[Box] = [((0.0, 0.0, 0.0), (2.5, 5.0, 0.0)), ((3.5, 0.0, 0.0), (6.0, 5.0, 0.0))]


@pytest.mark.parametrize(
    ("goal", "why"),
    [
        ((9.0, 1.0), "outside the map"),
        ((3.05, 1.0), "something stands there"),
        ((5.9, 2.5), "too narrow there: the radius can be 0.0"),
        ((4.5, 2.5), "way there is too narrow: the radius can be 0.0"),
    ],
)
def test_a_goal_that_cannot_be_reached_says_why_and_what_can(
    goal: tuple[float, float], why: str
) -> None:
    plan = plan_of(scene(SIZE_M, WALL))
    planner = Planner(plan, START_M, RADIUS_M)
    with pytest.raises(ProgroundError, match=why) as fault:
        planner.to_place(np.array(goal))
    assert_that_it_can_be_gone_to(planner, fault.value, np.array(goal))


def assert_that_it_can_be_gone_to(
    planner: Planner, fault: ProgroundError, goal_m: np.ndarray
) -> None:
    """The place named is reached, and no cell that is reached is nearer."""
    found = re.search(r"(-?[\d.]+),(-?[\d.]+), the nearest", fault.todo)
    assert found
    named_m = np.array([float(found[1]), float(found[2])])
    planner.to_place(named_m)
    plan: FloorPlan = planner.plan
    for cell in np.argwhere(plan.clearance_m >= RADIUS_M)[::7]:
        centre_m = plan.centres(cell)
        if np.linalg.norm(centre_m - goal_m) < np.linalg.norm(named_m - goal_m) - 0.01:
            with pytest.raises(ProgroundError):
                planner.to_place(centre_m)


def test_the_radius_said_to_fit_fits_and_a_larger_one_does_not() -> None:
    plan, goal_m = plan_of(scene(SIZE_M, WALL)), np.array([4.5, 2.5])
    with pytest.raises(ProgroundError) as fault:
        Planner(plan, START_M, RADIUS_M).to_place(goal_m)
    found = re.search(r"can be ([\d.]+) m at most", fault.value.what)
    assert found
    widest_m = float(found[1])
    assert 0.05 <= widest_m <= 0.15
    Planner(plan, START_M, widest_m).to_place(goal_m)
    with pytest.raises(ProgroundError):
        Planner(plan, START_M, widest_m + 0.01).to_place(goal_m)


def test_floor_nobody_saw_is_never_crossed() -> None:
    plan = plan_of(scene(SIZE_M, floor=GAP_FLOOR))
    planner = Planner(plan, START_M, RADIUS_M)
    with pytest.raises(ProgroundError, match="floor was not seen there"):
        planner.to_place(np.array([3.0, 2.0]))
    with pytest.raises(ProgroundError, match="no free floor leads there"):
        planner.to_place(np.array([4.5, 2.0]))
    apart = Planner(plan_of(scene(SIZE_M, SHUT)), START_M, RADIUS_M)
    cupboard = footprint(((5.0, 2.0, 0.0), (5.4, 2.4, 0.9)))
    with pytest.raises(ProgroundError, match="beside it there is room, but no free floor"):
        apart.to_thing(cupboard, "cupboard")


def test_a_start_where_the_robot_cannot_be_says_where_it_can() -> None:
    plan = plan_of(scene(SIZE_M, [CUPBOARD]))
    with pytest.raises(ProgroundError, match="something stands there") as fault:
        Planner(plan, np.array([2.5, 2.3]), RADIUS_M)
    found = re.search(r"start from ([\d.]+),([\d.]+)", fault.value.todo)
    assert found
    Planner(plan, np.array([float(found[1]), float(found[2])]), RADIUS_M)
    with pytest.raises(ProgroundError, match="no place on the floor has room"):
        Planner(plan, START_M, 4.0)
