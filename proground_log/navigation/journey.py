"""Finding a way across a finished run's floor: to a place, or to a thing that a text names."""

from __future__ import annotations

from dataclasses import dataclass

import networkx as nx
import numpy as np

from proground_log.errors import ProgroundError
from proground_log.mapping.objects import SceneObject
from proground_log.navigation.floor_plan import FloorPlan, Robot, draw_floor_plan
from proground_log.navigation.picture import Sight
from proground_log.navigation.planner import Planner, Route
from proground_log.navigation.voronoi import Cell
from proground_log.perception.map_texts import Texts
from proground_log.query.ask import Answer, query_surface, understand
from proground_log.query.mesh import Mesh
from proground_log.query.surface import Surface

MOST_THINGS = 10
"""A text may name several things: so many are tried, best first."""

Place = tuple[float, float]


@dataclass(frozen=True)
class Journey:
    """A way, and what it was found on.

    Args:
        goal: the text or the place.
        route: the way.
        plan: the floor.
        graph: the Voronoi graph for the robot.
        surface: of the map.
        robot: who drives.
        thing: what the text found, or None for a place.
        rank: which of the things found it is, from 1; better ones cannot be reached.
    """

    goal: str | Place
    route: Route
    plan: FloorPlan
    graph: nx.MultiGraph[Cell]
    surface: Surface
    robot: Robot
    thing: SceneObject | None = None
    rank: int = 1

    @property
    def name(self) -> str:
        """The goal in words."""
        return self.goal if isinstance(self.goal, str) else "{:.2f}, {:.2f}".format(*self.goal)


def navigate_surface(
    surface: Surface, start: Place, goal: str | Place, robot: Robot, *, texts: Texts = Texts()
) -> Journey:
    """Find a way across the floor of a surface.

    Args:
        surface: of a map; for a text of one with meaning.
        start: where the robot is: x and y of the floor plan, metres.
        goal: where to: such a place, or what to look for.
        robot: what drives.
        texts: embeddings of texts that the map does not know.

    Raises:
        ProgroundError: the run has no floor, nobody knows the text or nothing like it is there, or
            there is no way; it says why, and the nearest place that can be reached.
    """
    mesh, answer = surface.mesh, None
    if isinstance(goal, str):
        question = understand([goal], surface.description, texts=texts)
        (answer,) = query_surface(surface, question, MOST_THINGS)
        if not answer.things:
            raise ProgroundError(
                f"nothing like {goal!r} was found",
                where=surface.run.path,
                todo=f"see `pglog query {surface.run.path} {goal!r}`, or give a place: --to X,Y",
            )
    plan = draw_floor_plan(mesh.vertices_m, mesh.faces, surface.up, robot)
    planner = Planner(plan, np.array(start), robot.radius_m)
    if answer is None:
        route = planner.to_place(np.array(goal, np.float64))
        return Journey(goal, route, plan, planner.graph, surface, robot)
    route, rank = _to_first(planner, mesh, answer)
    thing = answer.things[rank - 1]
    return Journey(goal, route, plan, planner.graph, surface, robot, thing, rank)


def footprint(plan: FloorPlan, mesh: Mesh, thing: SceneObject) -> np.ndarray:
    """A thing's vertices within its extent, seen from above, [N, 2]."""
    points_m = mesh.vertices_m[thing.vertices].astype(np.float64)
    # A few lie outside: strays, to which nobody wants to drive.
    inside = ((points_m >= thing.lower_m) & (points_m <= thing.upper_m)).all(axis=1)
    return plan.ground.plan(points_m[inside] if inside.any() else thing.position_m[None])


def sight(journey: Journey) -> Sight | None:
    """The thing that a journey leads to as a floor plan shows it, if it leads to one."""
    if journey.thing is None:
        return None
    places_m = footprint(journey.plan, journey.surface.mesh, journey.thing)
    (left, low), (right, high) = places_m.min(axis=0), places_m.max(axis=0)
    corners_m = np.array([(left, low), (right, low), (right, high), (left, high)])
    return Sight(journey.name, corners_m)


def _to_first(planner: Planner, mesh: Mesh, answer: Answer) -> tuple[Route, int]:
    """A way to the best of the things that can be reached, and its rank."""
    faults: list[ProgroundError] = []
    for rank, thing in enumerate(answer.things, start=1):
        try:
            place_m = footprint(planner.plan, mesh, thing)
            return planner.to_thing(place_m, answer.query), rank
        except ProgroundError as fault:
            faults.append(fault)
    raise faults[0]
