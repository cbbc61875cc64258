"""The room as flat arrays for the compiled loops, with a tree of boxes and a grid on each side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from recorders.room.scene import Scene
from recorders.room.shapes import BOX, ELLIPSOID, FRUSTUM, SIDES, Primitive

GRID_M = 0.045
"""Longest step of the grids that carry light and become the ground-truth mesh."""

LEAF_SIZE = 3
MINIMUM_TURNS = 8


class Geometry(NamedTuple):
    """P bodies, N tree nodes, S sides; few wide tables, as every compiled call hands them on.

    Args:
        shape: size_m (see Primitive), local_from_world rotation by rows, position_m; columns
            from SIZE, ROTATION and POSITION on, float64 [P, 15].
        paint: linear colour, second colour, scale_m and emission; columns from RGB, SECOND_RGB,
            SCALE and EMISSION on, float64 [P, 8].
        kind: kind, pattern and first row in `sides`; columns KIND, PATTERN and FIRST_SIDE,
            int64 [P, 3].
        node_box_m: lower and upper corner, float64 [N, 6].
        node_link: the node to go on with after a miss, first place in `order`, number of bodies
            (0 for an inner node, whose first child follows it), int64 [N, 3].
        order: bodies in the order of the leaves, int64 [P].
        sides: columns and rows of cells of the side's grid, which has one more point than cells
            each way, and the number of its first point among all grid points, int64 [S, 3].
    """

    shape: np.ndarray
    paint: np.ndarray
    kind: np.ndarray
    node_box_m: np.ndarray
    node_link: np.ndarray
    order: np.ndarray
    sides: np.ndarray


SIZE, ROTATION, POSITION = 0, 3, 12
RGB, SECOND_RGB, SCALE, EMISSION = 0, 3, 6, 7
KIND, PATTERN, FIRST_SIDE = 0, 1, 2
COLUMNS, ROWS, OFFSET = 0, 1, 2


def pack(scene: Scene) -> Geometry:
    """The scene's bodies as arrays."""
    parts = scene.primitives
    materials = [part.material for part in parts]
    world_from_local = np.stack([part.world_from_local for part in parts])
    grids = [cells(part, side) for part in parts for side in range(SIDES[part.kind])]
    columns, rows = np.array(grids, dtype=np.int64).T
    points = (columns + 1) * (rows + 1)
    counts = np.array([SIDES[part.kind] for part in parts], dtype=np.int64)
    rotation = world_from_local[:, :3, :3].transpose(0, 2, 1).reshape(-1, 9)
    sizes_m = np.array([part.size_m for part in parts])
    paint = [
        _linear([material.rgb for material in materials]),
        _linear([material.second_rgb for material in materials]),
        np.array([(material.scale_m, material.emission) for material in materials]),
    ]
    node_box_m, node_link, order = _tree(parts)
    return Geometry(
        shape=np.hstack([sizes_m, rotation, world_from_local[:, :3, 3]]),
        paint=np.hstack(paint),
        kind=np.stack(
            [
                np.array([part.kind for part in parts]),
                np.array([material.pattern for material in materials]),
                np.cumsum(counts) - counts,
            ],
            axis=1,
        ),
        node_box_m=node_box_m,
        node_link=node_link,
        order=order,
        sides=np.stack([columns, rows, np.cumsum(points) - points], axis=1),
    )


def cells(part: Primitive, side: int) -> tuple[int, int]:
    """Columns and rows of the grid on one side of a body, for steps of at most GRID_M."""
    a, b, c = part.size_m
    if part.kind == BOX:
        axis = side // 2
        return _steps(2 * part.size_m[(axis + 1) % 3]), _steps(2 * part.size_m[(axis + 2) % 3])
    if part.kind == ELLIPSOID:
        around_m, along_m = 2 * np.pi * max(a, b), np.pi * max(a, b, c)
        return max(MINIMUM_TURNS, _steps(around_m)), max(MINIMUM_TURNS // 2, _steps(along_m))
    if part.kind == FRUSTUM:
        radius_m = (max(a, b), a, b)[side]
        reach_m = (float(np.hypot(a - b, 2 * c)), a, b)[side]
        return max(MINIMUM_TURNS, _steps(2 * np.pi * radius_m)), _steps(reach_m)
    return _steps(2 * a), _steps(2 * b)


def _steps(length_m: float) -> int:
    return max(1, int(np.ceil(length_m / GRID_M)))


def _linear(srgb: list[tuple[float, float, float]]) -> np.ndarray:
    """Linear light of sRGB colours, with the gamma of `render.py`."""
    return np.minimum(np.array(srgb, dtype=np.float64), 1.0) ** 2.2


def _tree(parts: tuple[Primitive, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A box tree, split at the median of the longest side: node_box_m, node_link and order."""
    corners = [part.aabb() for part in parts]
    lower = np.array([low for low, _ in corners]) - 1e-6
    upper = np.array([high for _, high in corners]) + 1e-6
    centers = (lower + upper) / 2
    nodes: list[tuple[np.ndarray, np.ndarray, int, int]] = []
    skips: list[int] = []
    order: list[int] = []

    def grow(members: np.ndarray) -> None:
        is_leaf = len(members) <= LEAF_SIZE
        number = len(nodes)
        low, high = lower[members].min(axis=0), upper[members].max(axis=0)
        nodes.append((low, high, len(order), len(members) if is_leaf else 0))
        skips.append(0)
        if is_leaf:
            order.extend(int(member) for member in members)
        else:
            spread = np.ptp(centers[members], axis=0)
            along = centers[members, int(np.argmax(spread))]
            ranked = members[np.argsort(along, kind="stable")]
            grow(ranked[: len(ranked) // 2])
            grow(ranked[len(ranked) // 2 :])
        skips[number] = len(nodes)

    grow(np.arange(len(parts)))
    node_box_m = np.array([[*low, *high] for low, high, _, _ in nodes])
    links = [(skip, first, n) for skip, (_, _, first, n) in zip(skips, nodes, strict=True)]
    return node_box_m, np.array(links, dtype=np.int64), np.array(order, dtype=np.int64)


class Grid(NamedTuple):
    """All grid points, side by side in the order of the bodies; G points.

    Args:
        body, side: where the point lies, int64 [G].
        u, v: its place on the side, 0 to 1, float64 [G].
    """

    body: np.ndarray
    side: np.ndarray
    u: np.ndarray
    v: np.ndarray


def grid_points(geometry: Geometry) -> Grid:
    """The grid points of every side; within a side the column runs fastest."""
    bodies, sides, us, vs = [], [], [], []
    for body, (kind, _, first) in enumerate(geometry.kind):
        for side in range(SIDES[int(kind)]):
            columns, rows, _ = geometry.sides[first + side]
            u, v = np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1)
            grid_v, grid_u = np.meshgrid(v, u, indexing="ij")
            bodies.append(np.full(grid_u.size, body))
            sides.append(np.full(grid_u.size, side))
            us.append(grid_u.ravel())
            vs.append(grid_v.ravel())
    return Grid(*(np.concatenate(part) for part in (bodies, sides, us, vs)))
