"""Free, occupied, unknown: on small rooms whose every cell is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from proground_log.errors import ProgroundError
from proground_log.navigation.floor_plan import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Robot,
    draw_floor_plan,
)
from tests.navigation.scenes import Z_UP, Box, distance_m, plan_of, scene

SIZE_M = (3.98, 2.98)
TABLE: Box = ((1.01, 1.01, 0.4), (1.99, 1.99, 0.5))


def state_at(plan, x_m: float, y_m: float) -> int:  # type: ignore[no-untyped-def]
    cell = plan.cell_of(np.array([x_m, y_m]))
    return UNKNOWN if cell is None else int(plan.cells[cell])


def test_every_cell_of_a_small_room_is_what_it_is() -> None:
    plan = plan_of(scene(SIZE_M, [TABLE]))
    expected = np.full((80, 60), FREE)
    expected[20:40, 20:40] = OCCUPIED
    np.testing.assert_array_equal(plan.cells, expected)
    np.testing.assert_allclose(plan.origin_m, 0.0)
    assert plan.ground.floor_m == pytest.approx(0.0)


def test_only_what_the_robot_would_hit_is_in_its_way() -> None:
    lamp: Box = ((0.51, 0.51, 1.2), (0.79, 0.79, 1.5))
    rug: Box = ((2.31, 0.51, 0.0), (2.79, 0.79, 0.03))
    room = scene(SIZE_M, [TABLE, lamp, rug])
    plan = plan_of(room)
    assert state_at(plan, 0.65, 0.65) == FREE
    assert state_at(plan, 2.55, 0.65) == FREE
    tall = plan_of(room, Robot(height_m=1.3))
    assert state_at(tall, 0.65, 0.65) == OCCUPIED
    low = plan_of(room, Robot(height_m=0.35))
    assert state_at(low, 1.5, 1.5) == FREE
    careful = plan_of(room, Robot(step_m=0.02))
    assert state_at(careful, 2.55, 0.65) == OCCUPIED


def test_floor_that_nobody_saw_is_unknown_and_never_free() -> None:
    halves = [((0.0, 0.0, 0.0), (1.5, 2.0, 0.0)), ((2.0, 0.0, 0.0), (3.5, 2.0, 0.0))]
    plan = plan_of(scene(SIZE_M, floor=halves))
    assert [state_at(plan, x_m, 1.0) for x_m in (0.7, 1.77, 2.7, 9.0)] == [
        FREE,
        UNKNOWN,
        FREE,
        UNKNOWN,
    ]
    assert plan.clearance_m[plan.cells == UNKNOWN].max() == 0


@pytest.mark.parametrize(
    "up", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (0.1, -0.9, 0.3)]
)
def test_the_plan_is_the_same_whichever_way_is_up(up: tuple[float, float, float]) -> None:
    """Of a room turned so that `up` is up, seen from above, the plan is that of the room."""
    room = scene(SIZE_M, [TABLE])
    direction = np.array(up) / np.linalg.norm(up)
    axes = draw_floor_plan(room.vertices_m, room.faces, Z_UP, Robot()).ground.plan_from_world
    np.testing.assert_array_equal(axes, np.eye(3))
    turned, _ = Rotation.align_vectors(direction[None], Z_UP[None])
    world = room.moved(turned.as_matrix())
    plan = draw_floor_plan(world.vertices_m, world.faces, direction, Robot())
    rotation = plan.ground.plan_from_world
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation[2], direction, atol=1e-9)
    # A place of the room, by way of the world, on the plan.
    for x_m, y_m, state in ((1.5, 1.5, OCCUPIED), (0.5, 0.5, FREE), (3.5, 2.5, FREE)):
        point_m = turned.as_matrix() @ (x_m, y_m, 0.0)
        place_m = plan.ground.plan(point_m)
        assert state_at(plan, *place_m) == state
        np.testing.assert_allclose(plan.ground.world(place_m), point_m, atol=1e-6)
        assert plan.ground.height(point_m) == pytest.approx(0, abs=1e-6)
    assert (plan.cells == OCCUPIED).sum() == pytest.approx(400, rel=0.25)


def test_a_world_that_is_level_keeps_its_axes() -> None:
    room = scene(SIZE_M)
    nearly = np.array([0.01, -0.02, 1.0])
    plan = draw_floor_plan(room.vertices_m, room.faces, nearly, Robot())
    np.testing.assert_array_equal(plan.ground.plan_from_world, np.eye(3))
    assert plan.ground.axis_names == ("x", "y")


def test_the_floor_is_the_lowest_large_level() -> None:
    """Neither a table top that is larger, nor a speck below."""
    top: Box = ((0.0, 0.0, 0.69), (3.9, 1.9, 0.7))
    floor = [((0.0, 0.0, 0.0), (3.98, 1.5, 0.0)), ((1.0, 1.0, -0.8), (1.2, 1.2, -0.8))]
    plan = plan_of(scene(SIZE_M, [top], floor=floor))
    assert plan.ground.floor_m == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("cell_m", [0.05, 0.025])
def test_clearance_is_never_more_than_there_is_and_hardly_less(cell_m: float) -> None:
    boxes: list[Box] = [TABLE, ((2.53, 0.32, 0.0), (2.91, 2.13, 0.8))]
    plan = plan_of(scene(SIZE_M, boxes), cell_m=cell_m)
    places_m = np.random.default_rng(0).uniform((0, 0), SIZE_M, (20_000, 2))
    true_m = distance_m(places_m, SIZE_M, boxes)
    read_m = plan.clearance_at(places_m)
    far = true_m > 4 * cell_m
    # The floor's rim lies within its last cells, and a cell with any floor is floor.
    assert (read_m - true_m)[far].max() < 0.6 * cell_m
    inner = far & (distance_m(places_m, SIZE_M, []) > true_m + 2 * cell_m)
    assert (read_m - true_m)[inner].max() <= 1e-9
    assert (true_m - read_m)[inner].max() < 2 * cell_m


def test_what_makes_no_sense_is_refused() -> None:
    for make in (
        lambda: Robot(radius_m=0),
        lambda: Robot(radius_m=float("nan")),
        lambda: Robot(height_m=0.05),
    ):
        with pytest.raises(ProgroundError, match="robot"):
            make()
    wall = scene(SIZE_M, floor=[((0.0, 0.0, 0.0), (1.0, 1.0, 0.0))])
    with pytest.raises(ProgroundError, match="shows no floor"):
        draw_floor_plan(wall.vertices_m, wall.faces, np.array([1.0, 0, 0]), Robot())
