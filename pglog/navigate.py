"""The command that finds a way: navigate."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pglog.common import SAME, AsJson, Run, err, print_table, warn
from proground_log.errors import ProgroundError
from proground_log.query.voxels import OBJECTS_VOXEL_M

if TYPE_CHECKING:
    from proground_log.navigation.journey import Journey


def navigate_command(
    run: Run,
    *,
    start: Annotated[str, tyro.conf.arg(name="from", metavar="X,Y")],
    to: Annotated[str, tyro.conf.arg(metavar="TEXT|X,Y")],
    robot_radius: float = 0.18,
    robot_height: float = 1.0,
    vocabulary: Path | None = None,
    text_encoder: Path | None = None,
    voxel_m: float = OBJECTS_VOXEL_M,
    as_json: AsJson = False,
    png: Path | None = None,
    rrd: Path | None = None,
    overwrite: bool = False,
    log: Path | None = None,
) -> int:
    """Find a safe way across the floor to a thing ("sink") or a place.

    Places are x,y in metres on the floor plan that --png draws: the world's own level axes. One
    that begins with a minus is given as --from=-1,2.

    Args:
        run: folder of a finished run.
        start: where the robot is.
        to: what to go to, of a log with regions, or where.
        robot_radius: of the circle that the robot needs, in metres.
        robot_height: what hangs higher than this it passes under, in metres.
        vocabulary: embeddings of texts that are none of the task's prompts (.npz).
        text_encoder: computes the embeddings of such texts (.onnx).
        voxel_m: voxels of the surface that the floor plan is drawn of.
        as_json: print JSON, for programs.
        png: a floor plan with the way to draw (.png).
        rrd: a recording of the robot driving to write, for rerun (.rrd).
        overwrite: replace the picture and the recording.
        log: the run's log, where it has moved: it tells objects apart, and says what is up.
    """
    from proground_log.files import require_free
    from proground_log.navigation.floor_plan import Robot
    from proground_log.navigation.journey import navigate_surface, sight
    from proground_log.navigation.picture import draw_route
    from proground_log.perception.map_texts import Texts
    from proground_log.query.surface import Surfaces
    from proground_log.run.opened import OpenedRun
    from proground_log.telemetry.path_recording import draw_journey

    for output in (png, rrd):
        if output is not None:
            require_free(output, overwrite=overwrite)
    begin = _place(start)
    if begin is None:
        raise ProgroundError(
            f"{start!r} is no place", where="--from", todo="give x,y in metres, such as 1.5,2"
        )
    robot = Robot(robot_radius, robot_height)
    with err.status("looking for a way"):
        opened = OpenedRun.finished(run, log)
        goal = _place(to) or to
        if isinstance(goal, str):
            opened.require_meaning()
        surface = Surfaces(opened).at(voxel_m)
        texts = Texts(vocabulary, text_encoder)
        journey = navigate_surface(surface, begin, goal, robot, texts=texts)
        if png is not None:
            draw_route(png, journey.plan, journey.graph, journey.route, sight(journey))
        if rrd is not None:
            draw_journey(rrd, journey)
    if journey.thing is not None and journey.surface.caveat:
        warn(journey.surface.caveat)
    if as_json:
        print(json.dumps(_as_json(journey), indent=2))
        return SAME
    _print(journey)
    if png is not None:
        print(f"floor plan: {png}")
    if rrd is not None:
        print(f"look at it: pglog view {rrd}")
    return SAME


def _place(text: str) -> tuple[float, float] | None:
    """A place, where a text is one."""
    try:
        x_m, y_m = map(float, text.split(","))
    except ValueError:
        return None
    return (x_m, y_m) if math.isfinite(x_m) and math.isfinite(y_m) else None


def _as_json(journey: Journey) -> dict[str, object]:
    from proground_log.exports.objects import rounded

    route, ground, thing = journey.route, journey.plan.ground, journey.thing
    found: dict[str, object] | None = None
    if thing is not None:
        found = {
            "query": journey.name,
            "rank": journey.rank,
            "label": thing.label,
            "position_m": rounded(thing.position_m),
            "lower_m": rounded(thing.lower_m),
            "upper_m": rounded(thing.upper_m),
            "score": round(thing.score, 4),
        }
    return {
        "length_m": round(route.length_m, 3),
        "least_clearance_m": _floored(route.clearance_m.min()),
        "turns": route.turns,
        "robot": {"radius_m": journey.robot.radius_m, "height_m": journey.robot.height_m},
        "axes": list(ground.axis_names),
        "up": [round(float(value), 6) for value in ground.plan_from_world[2]],
        "floor_m": round(ground.floor_m, 3),
        "start": rounded(route.corners_m[0]),
        "goal": rounded(route.corners_m[-1]),
        "goal_heading_rad": round(route.heading_rad, 4),
        "object": found,
        "points_m": [rounded(point_m) for point_m in ground.world(route.points_m)],
        "clearance_m": [_floored(value) for value in route.clearance_m],
    }


def _floored(clearance_m: float) -> float:
    """To the tenth of a millimetre below; but a billionth more was an error of rounding."""
    return math.floor((float(clearance_m) + 1e-9) * 1e4) / 1e4


def _print(journey: Journey) -> None:
    route, thing = journey.route, journey.thing
    rows = {
        "length": f"{route.length_m:.2f} m",
        "least clearance": f"{route.clearance_m.min():.2f} m (radius {route.radius_m:.2f} m)",
        "turns": str(route.turns),
        "goal": "{:.2f}, {:.2f}".format(*route.corners_m[-1]),
    }
    if thing is not None:
        x_m, y_m, z_m = thing.position_m
        place = f"{x_m:.2f} {y_m:.2f} {z_m:.2f}"
        rows["thing"] = f"{journey.name} at {place}, score {thing.score:.2f}"
        if journey.rank > 1:
            rows["thing"] += f", number {journey.rank}: better ones cannot be reached"
    print_table(f"the way to {journey.name}", rows)
