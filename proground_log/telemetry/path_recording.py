"""The rerun recording of a way: the map, the free floor, and the robot driving along the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from proground_log.mapping.boxes import OrientedBox
from proground_log.navigation.journey import Journey
from proground_log.telemetry.boxes import boxes3d
from proground_log.telemetry.scene import scene_blueprint, scene_recording, scene_view
from proground_log.telemetry.surface import coloured, heat_colors

TIMELINE = "drive"
SPEED_M_S = 0.5
FULL_M = 1.0
"""The clearance at which the floor's colours end."""
LIFT_M = 0.02
"""Lines lie so much above the floor, which would else hide half of them."""
PATH_COLOR, BOX_COLOR, ROBOT_COLOR = (255, 140, 0), (255, 90, 60), (0, 200, 255)
GRAPH_COLOR, START_COLOR = (235, 235, 235), (60, 220, 120)


@dataclass(frozen=True)
class PathDrawing:
    """What is drawn of a way. All points are in world axes.

    Args:
        name: the goal, in words.
        up: the world's upward direction [3].
        points_m: the way on the floor, close points, [P, 3].
        heading: where to look once there, [3].
        radius_m, height_m: of the robot.
        graph_m: lines of the Voronoi graph, each [N, 3].
        free_m: centres of the free cells of the floor, [F, 3].
        free_clearance_m: theirs, [F].
        cell_m: side of a cell.
        box: of the thing to go to, or None.
    """

    name: str
    up: np.ndarray
    points_m: np.ndarray
    heading: np.ndarray
    radius_m: float
    height_m: float
    graph_m: Sequence[np.ndarray]
    free_m: np.ndarray
    free_clearance_m: np.ndarray
    cell_m: float
    box: OrientedBox | None


def draw_journey(path: Path, journey: Journey) -> None:
    """Write an .rrd file whose timeline `drive` is the time of a robot at SPEED_M_S.

    Args:
        path: the file, replaced if it is there.
        journey: as `navigate_surface` gives it.
    """
    surface = journey.surface
    drawing = _drawing_of(journey)
    x_m, y_m = journey.route.corners_m[0]
    with scene_recording(path, surface, f"{x_m:.3f}, {y_m:.3f} to {journey.name}") as recording:
        view = scene_view(f"The way to {drawing.name}")
        recording.send_blueprint(scene_blueprint(view, timeline=TIMELINE))
        recording.log("world/map", coloured(surface.mesh, surface.mesh.colors), static=True)
        _log_floor(recording, drawing)
        _log_way(recording, drawing)
        _log_drive(recording, drawing)


def _drawing_of(journey: Journey) -> PathDrawing:
    plan, route, thing = journey.plan, journey.route, journey.thing
    lines = [edge["cells"] for _, _, edge in journey.graph.edges(data=True)]
    up = plan.ground.plan_from_world
    return PathDrawing(
        name=journey.name,
        up=up[2],
        points_m=plan.ground.world(route.points_m),
        heading=up[:2].T @ (np.cos(route.heading_rad), np.sin(route.heading_rad)),
        radius_m=journey.robot.radius_m,
        height_m=journey.robot.height_m,
        graph_m=[plan.ground.world(plan.centres(cells)) for cells in lines],
        free_m=plan.ground.world(plan.centres(np.argwhere(plan.clearance_m > 0))),
        free_clearance_m=plan.clearance_m[plan.clearance_m > 0],
        cell_m=plan.cell_m,
        box=None if thing is None else thing.box,
    )


def _log_floor(recording: rr.RecordingStream, drawing: PathDrawing) -> None:
    lift_m = LIFT_M * drawing.up
    floor = rr.Points3D(
        drawing.free_m + lift_m / 2,
        colors=heat_colors(np.clip(drawing.free_clearance_m / FULL_M, 0, 1)),
        radii=drawing.cell_m / 2,
    )
    recording.log("world/floor/clearance", floor, static=True)
    lines = [line + lift_m for line in drawing.graph_m]
    graph = rr.LineStrips3D(lines, colors=GRAPH_COLOR, radii=0.004)
    recording.log("world/floor/voronoi", graph, static=True)


def _log_way(recording: rr.RecordingStream, drawing: PathDrawing) -> None:
    way_m = drawing.points_m + 2 * LIFT_M * drawing.up
    strip = rr.LineStrips3D([way_m], colors=PATH_COLOR, radii=0.025)
    recording.log("world/way/line", strip, static=True)
    ends = rr.Points3D(
        way_m[[0, -1]],
        colors=[START_COLOR, BOX_COLOR],
        radii=0.07,
        labels=["start", drawing.name],
        show_labels=drawing.box is None,
    )
    recording.log("world/way/ends", ends, static=True)
    if drawing.box is not None:
        box = boxes3d([drawing.box], [drawing.name], BOX_COLOR)
        recording.log("world/way/goal", box, static=True)


def _log_drive(recording: rr.RecordingStream, drawing: PathDrawing) -> None:
    steps_m = np.linalg.norm(np.diff(drawing.points_m, axis=0), axis=1)
    seconds = np.concatenate([[0.0], np.cumsum(steps_m)]) / SPEED_M_S
    times = [rr.TimeColumn(TIMELINE, duration=seconds)]
    body = rr.Cylinders3D(
        lengths=[drawing.height_m],
        radii=[drawing.radius_m],
        centers=[(0.0, 0.0, drawing.height_m / 2)],
        colors=ROBOT_COLOR,
        fill_mode=rr.components.FillMode.MajorWireframe,
    )
    recording.log("world/robot", body, static=True)
    ahead = np.concatenate([np.diff(drawing.points_m, axis=0), [drawing.heading]])
    # The robot's own axes: ahead, left, up. Points on one spot have no direction of their own.
    ahead = np.where(np.linalg.norm(ahead, axis=1, keepdims=True) > 0, ahead, drawing.heading)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    up = np.broadcast_to(drawing.up, ahead.shape)
    turned = Rotation.from_matrix(np.stack([ahead, np.cross(up, ahead), up], axis=-1))
    moved = rr.Transform3D.columns(
        translation=drawing.points_m, quaternion=turned.as_quat(canonical=True)
    )
    recording.send_columns("world/robot", indexes=times, columns=moved)
    nose = rr.Arrows3D(
        vectors=[(1.6 * drawing.radius_m, 0, 0)],
        origins=[(0, 0, LIFT_M * 3)],
        colors=ROBOT_COLOR,
        radii=0.02,
    )
    recording.log("world/robot/ahead", nose, static=True)
