"""Pulling a way taut without coming too near to anything."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from proground_log.navigation.floor_plan import FloorPlan

COMFORT = 2.0
"""Radii of clearance from which on more of it is worth nothing."""
NARROW = 0.5
"""What a metre costs more where there is just room, as if it were 1.5 m long.

At a clearance of c a metre costs 1 + NARROW (1 - c / comfort), so at most 1.25: a way that costs
least is never more than 1.25 times as long as the shortest that it was chosen from.
"""
SAMPLES = 2.0
"""A cell's side has so many samples of a line."""
MOST_POINTS = 60
"""Of a way, to jump between: the time taken grows with the square. Each round cuts what it got."""
ROUNDS = 3


def smoothed(plan: FloorPlan, way_m: np.ndarray, radius_m: float) -> np.ndarray:
    """A cheaper way with the same ends, corners cut as far as the clearance allows.

    Of all the ways that jump from point to point of the old one in straight lines, the cheapest;
    and then again, of points along the new one.

    Args:
        plan: the floor.
        way_m: corners [N, 2] of a way along which the robot fits.
        radius_m: the least clearance.

    Returns:
        Corners [M, 2].
    """
    for _ in range(ROUNDS):
        way_m = _cheapest(plan, _resampled(plan, way_m), radius_m)
    return way_m


def length_m(way_m: np.ndarray) -> float:
    """The length of a way by its corners [N, 2]."""
    return float(np.linalg.norm(np.diff(way_m, axis=0), axis=1).sum())


def cost_m(plan: FloorPlan, way_m: np.ndarray, radius_m: float) -> float:
    """What a way [N, 2] costs, in metres of open floor; inf where the robot does not fit."""
    return float(sum(_costs(plan, a, b[None], radius_m)[0] for a, b in pairwise(way_m)))


def dense(way_m: np.ndarray, spacing_m: float) -> np.ndarray:
    """A way's corners [N, 2], and points between them that are no farther apart than this."""
    parts = [way_m[:1]]
    for a, b in pairwise(way_m):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing_m)))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


def _resampled(plan: FloorPlan, way_m: np.ndarray) -> np.ndarray:
    """Points to jump between: the corners, and others in between."""
    return dense(way_m, max(plan.cell_m, length_m(way_m) / MOST_POINTS))


def _cheapest(plan: FloorPlan, points_m: np.ndarray, radius_m: float) -> np.ndarray:
    cost = np.full(len(points_m), np.inf)
    cost[0], before = 0.0, np.zeros(len(points_m), int)
    for i in range(len(points_m) - 1):
        there = cost[i] + _costs(plan, points_m[i], points_m[i + 1 :], radius_m)
        better = np.flatnonzero(there < cost[i + 1 :] - 1e-9)
        cost[i + 1 + better], before[i + 1 + better] = there[better], i
    way = [len(points_m) - 1]
    while way[-1]:
        way.append(int(before[way[-1]]))
    return points_m[way[::-1]]


def _costs(plan: FloorPlan, start_m: np.ndarray, ends_m: np.ndarray, radius_m: float) -> np.ndarray:
    """What straight lines from a point [2] to others [N, 2] cost, [N]."""
    lengths_m = np.linalg.norm(ends_m - start_m, axis=1)
    count = max(2, int(np.ceil(SAMPLES * lengths_m.max(initial=0) / plan.cell_m)) + 1)
    along = np.linspace(0, 1, count)[None, :, None]
    clearance_m = plan.clearance_at(start_m + (ends_m - start_m)[:, None] * along)
    shortfall = np.maximum(1 - clearance_m / (COMFORT * radius_m), 0.0).mean(axis=1)
    # What was computed twice may differ in the last digit.
    fits = clearance_m.min(axis=1) >= radius_m - 1e-9
    return np.where(fits, lengths_m * (1 + NARROW * shortfall), np.inf)
