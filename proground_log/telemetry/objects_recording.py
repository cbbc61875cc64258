"""The rerun recording of a map's objects: their boxes, and the map in their labels' colours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from proground_log.mapping.objects import SceneObject
from proground_log.query.mesh import Mesh
from proground_log.query.objects import object_of_vertices
from proground_log.query.surface import Surface
from proground_log.telemetry.boxes import boxes3d
from proground_log.telemetry.scene import scene_blueprint, scene_recording, scene_view
from proground_log.telemetry.surface import coloured
from proground_log.telemetry.upright import overview

TINT = 0.7
"""Of an object's colour in the map's own: so much that one sees what it is of, and its shape."""
DIMMED = 0.5
"""Brightness of what is of no object."""


def draw_objects(path: Path, surface: Surface) -> None:
    """Write an .rrd file that opens with the boxes, and with the objects' surfaces beside them.

    Args:
        path: the file, replaced if it is there.
        surface: of a map with meaning.
    """
    mesh, task, objects = surface.mesh, surface.description.task, surface.objects
    by_label = dict(zip(task.all_prompts, task.prompt_colors(), strict=True))
    colors = np.array([by_label[thing.label] for thing in objects], np.uint8).reshape(-1, 3)
    with scene_recording(path, surface, "objects") as recording:
        recording.send_blueprint(_blueprint(overview(mesh.vertices_m, surface.up)))
        recording.log("world/map/color", coloured(mesh, mesh.colors), static=True)
        tinted = coloured(mesh, _tinted(mesh, objects, colors))
        recording.log("world/map/objects", tinted, static=True)
        names = [f"{number} {thing.label}" for number, thing in enumerate(objects, start=1)]
        boxes = boxes3d([thing.box for thing in objects], names, colors)
        recording.log("world/objects", boxes, static=True)


def _tinted(mesh: Mesh, objects: Sequence[SceneObject], colors: np.ndarray) -> np.ndarray:
    """The mesh's colours, uint8 [V, 3], with each object in its own; the rest is dim and grey."""
    gray = np.repeat(mesh.colors.mean(axis=1, keepdims=True), 3, axis=1)
    tinted = DIMMED * gray
    number = object_of_vertices(objects, len(gray))
    on_object = number >= 0
    own = colors.reshape(-1, 3)[number[on_object]]
    tinted[on_object] = TINT * own + (1 - TINT) * gray[on_object]
    return tinted.round().astype(np.uint8)


def _blueprint(eye: rrb.EyeControls3D) -> rrb.Blueprint:
    layers = ("color", "Objects"), ("objects", "What belongs to them")
    views = [
        scene_view(name, [f"+ $origin/map/{layer}", "+ $origin/objects"], eye)
        for layer, name in layers
    ]
    return scene_blueprint(rrb.Horizontal(*views))
