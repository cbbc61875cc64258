"""Shortest ways from cell to cell of a floor plan, for a robot of a radius."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from proground_log.navigation.floor_plan import FloorPlan

STEPS = ((1, 0), (0, 1), (1, 1), (1, -1))
"""From a cell to half of its eight neighbours; the other half is the same backwards."""


@dataclass(frozen=True)
class GridWays:
    """All shortest ways from one cell along the eight directions of the grid.

    Args:
        distance_m: float64 [X, Y], the length of the way to each cell; inf where there is none.
        _before: int [X * Y], the number of the cell before each on its way.
    """

    distance_m: np.ndarray
    _before: np.ndarray

    def to(self, cell: tuple[int, int]) -> np.ndarray:
        """The cells int [N, 2] of the way to a cell that there is a way to, both ends included."""
        shape = self.distance_m.shape
        way = [int(np.ravel_multi_index(cell, shape))]
        while self._before[way[-1]] >= 0:
            way.append(int(self._before[way[-1]]))
        return np.stack(np.unravel_index(way[::-1], shape), axis=-1)


def passable_steps(plan: FloorPlan, radius_m: float) -> csr_array:
    """The grid as a graph: cell by cell, the length of a step in metres, [X * Y, X * Y].

    A robot fits all along a step if it fits at both ends and, across a corner, half-way between
    the two cells beside: the clearance read linearly is nowhere lower than the least of these.
    """
    clearance_m, (columns, rows) = plan.clearance_m, plan.cells.shape
    numbers = np.arange(columns * rows).reshape(columns, rows)
    starts, ends, lengths = [], [], []
    for dx, dy in STEPS:
        x, y = np.s_[: columns - dx], np.s_[max(0, -dy) : rows - max(0, dy)]
        x_next, y_next = np.s_[dx:], np.s_[max(0, dy) : rows + min(0, dy)]
        fits = np.minimum(clearance_m[x, y], clearance_m[x_next, y_next]) >= radius_m
        if dx and dy:
            fits &= (clearance_m[x, y_next] + clearance_m[x_next, y]) / 2 >= radius_m
        starts.append(numbers[x, y][fits])
        ends.append(numbers[x_next, y_next][fits])
        lengths.append(np.full(len(starts[-1]), np.hypot(dx, dy) * plan.cell_m))
    pairs = np.concatenate(starts), np.concatenate(ends)
    shape = (numbers.size, numbers.size)
    return csr_array(coo_array((np.concatenate(lengths), pairs), shape=shape))


def ways_from(plan: FloorPlan, steps: csr_array, cell: tuple[int, int]) -> GridWays:
    """The shortest ways from a cell to all others, by the graph that `passable_steps` gives."""
    shape = plan.cells.shape
    number = int(np.ravel_multi_index(cell, shape))
    # Its types know indices as arrays only.
    found = dijkstra(steps, directed=False, indices=np.array([number]), return_predecessors=True)
    distance_m, before = (array[0] for array in found)
    return GridWays(distance_m.reshape(shape), before)
