"""What of the floor is free, what is occupied, and what nobody has seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from proground_log.errors import ProgroundError
from proground_log.navigation.ground import Ground, find_ground, level_faces

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
CELL_M = 0.05
"""What is lost to the size of a cell also makes up for walls that the map has a centimetre too far
off: on the built-in room no way in 156 came nearer to the truth than the radius and 2 cm, but with
cells of half the size one came nearer than the radius."""
HALF_CELL = 0.75
"""From a cell's centre to the farthest point of the cell, in cells, rounded up from 0.71: so much
is taken off every distance. What is rounded makes up for `clearance_at`."""
SPACING = 0.75
"""Between points on a surface, in cells, so that they leave out no cell that it covers."""


@dataclass(frozen=True)
class Robot:
    """A cylinder on wheels.

    Args:
        radius_m: of the circle that it needs.
        height_m: what is higher than this above the floor it passes under.
        step_m: what is lower than this above the floor it drives over.
    """

    radius_m: float = 0.18
    height_m: float = 1.0
    step_m: float = 0.1

    def __post_init__(self) -> None:
        faults = (
            (not 0 < self.radius_m < np.inf, f"the robot's radius is {self.radius_m} m"),
            (not 0 < self.step_m < np.inf, f"it drives over steps of {self.step_m} m"),
            (
                not self.step_m < self.height_m < np.inf,
                f"the robot's height is {self.height_m} m, its steps are {self.step_m} m",
            ),
        )
        for is_fault, what in faults:
            if is_fault:
                todo = "choose a radius and a step above 0, and a height above the step"
                raise ProgroundError(what, where="robot", todo=todo)


@dataclass(frozen=True)
class FloorPlan:
    """A grid over the floor.

    Args:
        ground: where the plan lies in the world.
        origin_m: float64 [2], the plan's x and y of the corner of cell (0, 0).
        cell_m: side of a cell.
        cells: uint8 [X, Y], UNKNOWN, FREE or OCCUPIED; the first index runs along the plan's x.
    """

    ground: Ground
    origin_m: np.ndarray
    cell_m: float
    cells: np.ndarray

    @cached_property
    def clearance_m(self) -> np.ndarray:
        """How far the cells' centres are at least from all that is not free, float64 [X, Y].

        The Euclidean distance to the centre of the nearest cell that is not free, less half the
        diagonal of a cell: a wall may stand anywhere in its cell. Beyond its border the plan is
        unknown, and so not free.
        """
        free = np.pad(self.cells == FREE, 1)
        distance = np.asarray(distance_transform_edt(free))[1:-1, 1:-1]
        return np.maximum(distance - HALF_CELL, 0.0) * self.cell_m

    def clearance_at(self, places_m: np.ndarray) -> np.ndarray:
        """The clearance at places [..., N, 2], read linearly between the cells' centres, [..., N].

        A distance d bulges by cell^2 / 8d between centres: from three cells on less than what
        HALF_CELL has to spare, so that this is still the least that it can be.
        """
        at = np.moveaxis((places_m - self.origin_m) / self.cell_m - 0.5, -1, 0)
        return np.asarray(map_coordinates(self.clearance_m, at, order=1, cval=0.0))

    def centres(self, cells: np.ndarray) -> np.ndarray:
        """Centres [..., 2] of cells int [..., 2]."""
        return np.asarray(self.origin_m + (cells + 0.5) * self.cell_m)

    def cell_of(self, place_m: np.ndarray) -> tuple[int, int] | None:
        """The cell of a place [2]; None outside the plan."""
        x, y = (int(n) for n in np.floor((place_m - self.origin_m) / self.cell_m))
        inside = 0 <= x < self.cells.shape[0] and 0 <= y < self.cells.shape[1]
        return (x, y) if inside else None


def draw_floor_plan(
    vertices_m: np.ndarray,
    faces: np.ndarray,
    up: np.ndarray,
    robot: Robot,
    cell_m: float = CELL_M,
) -> FloorPlan:
    """Find the floor in a mesh, and what stands on it.

    Occupied is a cell above which some surface lies between the robot's step and its height; free
    is one whose floor was seen, with nothing in that band above it; all others are unknown.

    Args:
        vertices_m: [V, 3], world axes.
        faces: int [F, 3], counter-clockwise seen from free space.
        up: the world's upward direction [3].
        robot: what drives there.
        cell_m: side of a cell.

    Raises:
        ProgroundError: the mesh shows no floor.
    """
    ground = find_ground(vertices_m, faces, up)
    heights_m = ground.height(vertices_m)[faces]
    near = (heights_m.max(axis=1) > -robot.step_m) & (heights_m.min(axis=1) < robot.height_m)
    faces = faces[near]
    is_level = level_faces(ground, vertices_m[faces].astype(np.float64))
    floor_m = _points(vertices_m, faces[is_level], cell_m)
    floor_m = floor_m[np.abs(ground.height(floor_m)) <= robot.step_m]
    things_m = _points(vertices_m, faces, cell_m)
    heights_m = ground.height(things_m)
    things_m = things_m[(heights_m > robot.step_m) & (heights_m < robot.height_m)]

    floor, things = ground.plan(floor_m), ground.plan(things_m)
    known = np.concatenate([floor, things])
    first = np.floor(known.min(axis=0) / cell_m)
    shape = (np.floor(known.max(axis=0) / cell_m) - first).astype(int) + 1
    cells = np.full(shape, UNKNOWN, np.uint8)
    for places, state in ((floor, FREE), (things, OCCUPIED)):
        cells[tuple((np.floor(places / cell_m) - first).astype(int).T)] = state
    return FloorPlan(ground, first * cell_m, cell_m, cells)


def _points(vertices_m: np.ndarray, faces: np.ndarray, cell_m: float) -> np.ndarray:
    """Points [N, 3] all over the faces, corners included, no farther apart than SPACING."""
    corners_m = vertices_m[faces].astype(np.float64)
    edges_m = np.linalg.norm(corners_m - np.roll(corners_m, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(edges_m / (SPACING * cell_m)), 1).astype(int)
    points_m = [np.zeros((0, 3))]
    for count in np.unique(parts).tolist():
        a, b = np.nonzero(np.tri(count + 1))
        weights = np.stack([a - b, b, count - a], axis=1) / count
        points_m.append((weights @ corners_m[parts == count]).reshape(-1, 3))
    return np.concatenate(points_m)
