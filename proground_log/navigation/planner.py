"""Ways from place to place, and to things; and why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import networkx as nx
import numpy as np
from scipy.ndimage import label
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from proground_log.errors import ProgroundError
from proground_log.navigation.floor_plan import FREE, OCCUPIED, FloorPlan
from proground_log.navigation.grid_ways import GridWays, passable_steps, ways_from
from proground_log.navigation.smoothing import cost_m, dense, length_m, smoothed
from proground_log.navigation.voronoi import Cell, voronoi_cells, voronoi_graph, way_on_graph

BESIDE_M = 1.0
"""Who stands this near to a thing, seen from above, stands beside it."""
SPACING_M = 0.05
TURN_DEG = 15.0
EVERYWHERE = np.ones((3, 3), int)


@dataclass(frozen=True)
class Route:
    """A way for a robot.

    Args:
        corners_m: float64 [N, 2], on the plan, from start to goal.
        radius_m: the robot's.
        points_m: float64 [P, 2], the corners and points between them.
        clearance_m: float64 [P], of the points, never below the radius.
        facing_m: float64 [2], what to look at once there, or None.
    """

    corners_m: np.ndarray
    radius_m: float
    points_m: np.ndarray
    clearance_m: np.ndarray
    facing_m: np.ndarray | None = None

    @property
    def length_m(self) -> float:
        """How long it is."""
        return length_m(self.corners_m)

    @property
    def turns(self) -> int:
        """At how many corners it turns by TURN_DEG or more."""
        steps = np.diff(self.corners_m, axis=0)
        headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        return int((np.abs(np.diff(headings)) >= np.radians(TURN_DEG)).sum())

    @property
    def heading_rad(self) -> float:
        """Where to look once there, from the plan's x towards its y."""
        ahead = self.corners_m[-1] - self.corners_m[-2] if len(self.corners_m) > 1 else (1.0, 0.0)
        x, y = ahead if self.facing_m is None else self.facing_m - self.corners_m[-1]
        return float(np.arctan2(y, x))


class Planner:
    """Plans from one start for a robot of one radius.

    Args:
        plan: the floor.
        start_m: where the robot is, [2] on the plan.
        radius_m: of the robot.

    Raises:
        ProgroundError: the robot cannot be there; says why, and the nearest place where it can.
    """

    def __init__(self, plan: FloorPlan, start_m: np.ndarray, radius_m: float) -> None:
        self.plan, self.radius_m, self._start_m = plan, radius_m, start_m
        fits = plan.clearance_m >= radius_m
        if not fits.any():
            raise ProgroundError(
                f"no place on the floor has room for a radius of {radius_m:.2f} m",
                where="robot",
                todo=f"it can be {plan.clearance_m.max():.2f} m at most",
            )
        cell = self._standing(start_m)
        if cell is None:
            nearest_m = self._nearest(start_m, fits)
            raise _unreachable("start", start_m, self._why_not(start_m), nearest_m, "start from")
        self._steps: csr_array = passable_steps(plan, radius_m)
        self._cell: Cell = cell
        self._ways: GridWays = ways_from(plan, self._steps, cell)
        self._voronoi: nx.Graph[Cell] = voronoi_cells(plan, radius_m)

    @property
    def graph(self) -> nx.MultiGraph[Cell]:
        """The Voronoi graph that ways follow; see `voronoi_graph`."""
        return voronoi_graph(self.plan, self._voronoi)

    def to_place(self, goal_m: np.ndarray) -> Route:
        """A way to a place [2].

        Raises:
            ProgroundError: there is none; says why, and the nearest place that can be reached.
        """
        cell = self._standing(goal_m)
        if cell is None or not np.isfinite(self._ways.distance_m[cell]):
            nearest_m = self._nearest(goal_m, np.isfinite(self._ways.distance_m))
            why = self._why_not(goal_m) if cell is None else self._why_apart(cell)
            raise _unreachable("goal", goal_m, why, nearest_m, "go to")
        return self._route(cell, goal_m)

    def to_thing(self, footprint_m: np.ndarray, name: str) -> Route:
        """A way to the nearest place beside a thing, to face it there.

        Of the places that are nearest to it but for a cell, the one with the shortest way.

        Args:
            footprint_m: points of the thing, seen from above, [N, 2].
            name: what it is called.

        Raises:
            ProgroundError: there is none; says why, and the nearest place that can be reached.
        """
        tree = cKDTree(footprint_m)
        fits = np.argwhere(self.plan.clearance_m >= self.radius_m)
        away_m, nearest = map(np.asarray, tree.query(self.plan.centres(fits)))
        ways_m = self._ways.distance_m[tuple(fits.T)]
        reached = np.isfinite(ways_m)
        best_m = away_m[reached].min()
        if best_m > BESIDE_M:
            chosen = int(np.where(reached, away_m, np.inf).argmin())
            middle_m = (footprint_m.min(axis=0) + footprint_m.max(axis=0)) / 2
            why = f"no floor within {BESIDE_M:g} m of it has room for the robot"
            if away_m.min() <= BESIDE_M:
                x, y = fits[away_m.argmin()]
                why = f"beside it there is room, but {self._why_apart((int(x), int(y)))}"
            place_m = self.plan.centres(fits[chosen])
            raise _unreachable(f"goal {name!r}", middle_m, why, place_m, "go to")
        candidates = reached & (away_m <= best_m + self.plan.cell_m)
        chosen = int(np.where(candidates, ways_m, np.inf).argmin())
        x, y = (int(n) for n in fits[chosen])
        return self._route((x, y), self.plan.centres(fits[chosen]), footprint_m[nearest[chosen]])

    def _route(self, cell: Cell, goal_m: np.ndarray, facing_m: np.ndarray | None = None) -> Route:
        """The better of two ways, both smoothed: along the Voronoi graph, and the shortest.

        Where a robot starts beside its goal, or an obstacle is passed on its longer side, the graph
        leads astray.
        """
        ways = [self._along_graph(cell), self._ways.to(cell)]
        taut = [
            smoothed(self.plan, self._with_ends(way, goal_m), self.radius_m)
            for way in ways
            if way is not None
        ]
        corners_m = min(taut, key=lambda way: cost_m(self.plan, way, self.radius_m))
        points_m = dense(corners_m, SPACING_M)
        clearance_m = self.plan.clearance_at(points_m)
        return Route(corners_m, self.radius_m, points_m, clearance_m, facing_m)

    def _along_graph(self, goal: Cell) -> np.ndarray | None:
        """Cells from the start to the graph, along it, and from it to the goal."""
        back = ways_from(self.plan, self._steps, goal)
        joins = [self._nearest_on_graph(ways) for ways in (self._ways, back)]
        on, off = joins
        if on is None or off is None:
            return None
        middle = way_on_graph(voronoi_graph(self.plan, self._voronoi, (on, off)), on, off)
        if middle is None:
            return None
        return np.concatenate([self._ways.to(on), middle[1:], back.to(off)[-2::-1]])

    def _nearest_on_graph(self, ways: GridWays) -> Cell | None:
        reached = [cell for cell in sorted(self._voronoi) if np.isfinite(ways.distance_m[cell])]
        return min(reached, key=lambda cell: float(ways.distance_m[cell]), default=None)

    def _with_ends(self, cells: np.ndarray, goal_m: np.ndarray) -> np.ndarray:
        """The centres of cells, from the very start to the very goal."""
        return np.concatenate([self._start_m[None], self.plan.centres(cells), goal_m[None]])

    def _standing(self, place_m: np.ndarray) -> Cell | None:
        """The cell from which a robot at a place drives on; None where it has no room there."""
        if self.plan.clearance_at(place_m[None])[0] < self.radius_m:
            return None
        corner = np.floor((place_m - self.plan.origin_m) / self.plan.cell_m - 0.5).astype(int)
        around = corner + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
        away_m = np.linalg.norm(self.plan.centres(around) - place_m, axis=1)
        for x, y in around[np.argsort(away_m, kind="stable")].tolist():
            middle_m = np.linspace(place_m, self.plan.centres(np.array([x, y])), 5)
            if (self.plan.clearance_at(middle_m) >= self.radius_m).all():
                return x, y
        return None

    def _nearest(self, place_m: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """The centre [2] of the nearest of the cells, bool [X, Y]."""
        centres_m = self.plan.centres(np.argwhere(cells))
        return np.asarray(centres_m[np.linalg.norm(centres_m - place_m, axis=1).argmin()])

    def _why_not(self, place_m: np.ndarray) -> str:
        """Why a robot cannot be at a place."""
        cell = self.plan.cell_of(place_m)
        if cell is None:
            return "it lies outside the map"
        if self.plan.cells[cell] != FREE:
            is_occupied = self.plan.cells[cell] == OCCUPIED
            return "something stands there" if is_occupied else "the floor was not seen there"
        room_m = _floored(float(self.plan.clearance_at(place_m[None])[0]))
        return f"it is too narrow there: the radius can be {room_m:.2f} m at most"

    def _why_apart(self, cell: Cell) -> str:
        """Why there is no way from the start to a cell on which the robot has room."""
        clearance_m = self.plan.clearance_m
        widths_m = np.unique(clearance_m[(clearance_m > 0) & (clearance_m < self.radius_m)])
        low, high = 0, len(widths_m)
        # The widest at which both are of one part: parts only grow as the width falls.
        while low < high:
            middle = (low + high + 1) // 2
            parts, _ = label(clearance_m >= widths_m[middle - 1], EVERYWHERE)
            is_one = parts[cell] == parts[self._cell]
            low, high = (middle, high) if is_one else (low, middle - 1)
        if not low:
            return "no free floor leads there from the start"
        room_m = _floored(float(widths_m[low - 1]))
        return f"the way there is too narrow: the radius can be {room_m:.2f} m at most"


def _floored(width_m: float) -> float:
    """To the centimetre below: what is said to fit must fit."""
    return float(np.floor(width_m * 100) / 100)


def _unreachable(
    role: str, place_m: np.ndarray, why: str, nearest_m: np.ndarray, verb: str
) -> ProgroundError:
    x, y = place_m
    near_x, near_y = nearest_m
    return ProgroundError(
        f"cannot be reached: {why}" if role != "start" else f"the robot cannot be there: {why}",
        where=f"{role} at {x:.2f},{y:.2f}",
        todo=f"{verb} {near_x:.3f},{near_y:.3f}, the nearest place that can be reached",
    )
