"""The rerun recording of a map's objects: their boxes, and the map in their labels' colours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from proground_log.events import MeshExtracted
from proground_log.files import file_sha256
from proground_log.log.upright import nearest_axis
from proground_log.query.objects import SceneObject, object_of_vertices
from proground_log.query.surface import Surface
from proground_log.telemetry.blueprint import BACKGROUND
from proground_log.telemetry.boxes import boxes3d
from proground_log.telemetry.rerun_sink import recording_written
from proground_log.telemetry.surface import surface
from proground_log.telemetry.upright import VIEW_COORDINATES, overview

TINT = 0.7
"""Of an object's colour in the map's own: so much that one sees what it is of, and its shape."""
DIMMED = 0.5
"""Brightness of what is of no object."""


def write_objects_recording(
    path: Path,
    recording_id: str,
    mesh: MeshExtracted,
    objects: Sequence[SceneObject],
    colors: np.ndarray,
    up: np.ndarray,
) -> None:
    """Write an .rrd file that opens with the boxes, and with the objects' surfaces beside them.

    Args:
        path: the file, replaced if it is there.
        recording_id: tells it from others in one viewer.
        mesh: the map's surface.
        objects: N of them, on that surface.
        colors: uint8 [N, 3], of their labels.
        up: the world's upward direction [3].
    """
    with recording_written(path, recording_id) as recording:
        eye = overview(mesh.vertices_m, up)
        recording.send_blueprint(_blueprint(eye))
        recording.log("world", VIEW_COORDINATES[nearest_axis(up)], static=True)
        recording.log("world/map/color", surface(mesh, mesh.colors), static=True)
        tinted = surface(mesh, _tinted(mesh, objects, colors))
        recording.log("world/map/objects", tinted, static=True)
        names = [f"{number} {thing.label}" for number, thing in enumerate(objects, start=1)]
        boxes = boxes3d([thing.box for thing in objects], names, colors)
        recording.log("world/objects", boxes, static=True)


def _tinted(mesh: MeshExtracted, objects: Sequence[SceneObject], colors: np.ndarray) -> np.ndarray:
    """The mesh's colours, uint8 [V, 3], with each object in its own; the rest is dim and grey."""
    gray = np.repeat(mesh.colors.mean(axis=1, keepdims=True), 3, axis=1)
    tinted = DIMMED * gray
    number = object_of_vertices(objects, len(gray))
    on_object = number >= 0
    own = colors.reshape(-1, 3)[number[on_object]]
    tinted[on_object] = TINT * own + (1 - TINT) * gray[on_object]
    return tinted.round().astype(np.uint8)


def _blueprint(eye: rrb.EyeControls3D) -> rrb.Blueprint:
    views = [
        rrb.Spatial3DView(
            origin="world",
            contents=[f"+ $origin/map/{layer}", "+ $origin/objects"],
            name=name,
            background=rrb.Background(color=BACKGROUND),
            line_grid=rrb.LineGrid3D(visible=False),
            eye_controls=eye,
        )
        for layer, name in (("color", "Objects"), ("objects", "What belongs to them"))
    ]
    return rrb.Blueprint(
        rrb.Horizontal(*views),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
    )


def draw_objects(path: Path, surface: Surface) -> None:
    """Write a rerun recording of a surface's objects; `path` is replaced if it is there."""
    mesh, task = surface.mesh, surface.description.task
    colors = dict(zip(task.all_prompts, task.prompt_colors(), strict=True))
    write_objects_recording(
        path,
        f"{file_sha256(surface.run.map)[:16]}: objects",
        MeshExtracted(0, mesh.vertices_m, mesh.faces, mesh.normals, mesh.colors),
        surface.objects,
        np.array([colors[thing.label] for thing in surface.objects], np.uint8).reshape(-1, 3),
        surface.up,
    )
