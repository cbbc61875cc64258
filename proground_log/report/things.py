"""The page's objects and its floor plan."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from proground_log.errors import ProgroundError
from proground_log.exports.objects import place_text
from proground_log.frame import evenly
from proground_log.mapping.objects import SceneObject
from proground_log.navigation.floor_plan import Robot, draw_floor_plan
from proground_log.query.surface import Surface, Surfaces
from proground_log.query.voxels import OBJECTS_VOXEL_M
from proground_log.report.figures import hex_color
from proground_log.report.floor_chart import Outline, floor_chart
from proground_log.report.page import Content, Note, Picture, Plan, Section, Table

MOST_POSES = 300


def thing_sections(surfaces: Surfaces) -> list[Section]:
    """The sections Objects and Floor plan, of a run whose log is there."""
    try:
        surface = surfaces.at(OBJECTS_VOXEL_M)
    except ProgroundError as error:
        nothing: list[Content] = [Note(f"None: {error.what}.")]
        return [Section("Objects", nothing), Section("Floor plan", nothing)]
    objects: list[SceneObject] = []
    listed: list[Content]
    if surface.run.map.description is None:
        listed = [Note("None: the log has no regions, so no meaning was learnt.")]
    else:
        objects = surface.objects
        listed = _table(objects) if objects else [Note("None was found.")]
        if surface.caveat:
            listed.append(Note(f"Note: {surface.caveat}."))
    return [
        Section("Objects", listed),
        Section("Floor plan", _plan(surface, objects)),
    ]


def _table(objects: list[SceneObject]) -> list[Content]:
    rows = [
        (
            f"{number} {thing.label}",
            place_text(thing.position_m, "  "),
            place_text(thing.box.extent_m, " x "),
            f"{thing.score:.2f}",
            "" if thing.views is None else str(thing.views),
        )
        for number, thing in enumerate(objects, start=1)
    ]
    return [Table(("object", "position m", "length x width x height m", "score", "views"), rows)]


def _plan(surface: Surface, objects: list[SceneObject]) -> list[Content]:
    robot = Robot()
    mesh = surface.mesh
    try:
        plan = draw_floor_plan(mesh.vertices_m, mesh.faces, surface.up, robot)
    except ProgroundError as error:
        return [Note(f"None: {error.what}.")]
    reader = surface.run.log
    chosen = evenly(len(reader), MOST_POSES)
    way_m = np.array([frame.world_from_camera[:3, 3] for frame in reader.frames(chosen)])
    outlines = []
    if objects:
        task = surface.description.task
        colors = dict(zip(task.all_prompts, map(hex_color, task.prompt_colors()), strict=True))
        for number, thing in enumerate(objects, start=1):
            corners_m = plan.ground.plan(thing.box.corners_m)
            around_m = corners_m[ConvexHull(corners_m).vertices]
            outlines.append(Outline(str(number), around_m, colors[thing.label]))
    uri = floor_chart(
        plan.cells,
        plan.origin_m,
        plan.cell_m,
        plan.ground.axis_names,
        plan.ground.plan(way_m),
        outlines,
    )
    title = (
        f"Seen from above; occupied: something between {robot.step_m:g} and {robot.height_m:g} m "
        f"above the floor; cells of {100 * plan.cell_m:g} cm. Numbers are those of the objects."
    )
    return [Plan(Picture(title, uri))]
