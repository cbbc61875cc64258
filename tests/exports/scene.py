"""A small scene with exact numbers: a table and two cups on it, in a room whose z is up."""

from __future__ import annotations

import numpy as np
import trimesh

from proground_log.exports.labels import SurfaceLabels, label_surface
from proground_log.mapping.objects import SceneObject
from proground_log.perception.task import Task
from proground_log.query.instances import Instance
from proground_log.query.mesh import Mesh
from proground_log.query.objects import object_of

TASK = Task("tidy", ("cup", "café table"), ("ghost",), colors={"cup": "#102030"})
UP = np.array([0.0, 0.0, 1.0])
PLACES = ((0.0, 0.0, 0.4), (0.3, 0.2, 0.85), (-0.3, -0.2, 0.85), (3.0, 0.0, 0.5))
"""Of the middles of table, cups and a box that is nothing in particular."""
SIZES = ((1.2, 0.8, 0.8), (0.1, 0.1, 0.1), (0.1, 0.1, 0.1), (0.5, 0.5, 1.0))


def scene_mesh() -> Mesh:
    """Four boxes of eight vertices, each box in colours of its own."""
    boxes = [
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(place))
        for size, place in zip(SIZES, PLACES, strict=True)
    ]
    whole = trimesh.util.concatenate(boxes)
    colors = np.repeat(np.array([[200, 100, 50], [0, 255, 1], [7, 8, 9], [90, 90, 90]]), 8, axis=0)
    return Mesh(
        whole.vertices.astype(np.float32),
        whole.faces.astype(np.int32),
        whole.vertex_normals.astype(np.float32),
        colors.astype(np.uint8),
    )


def scene_objects(mesh: Mesh) -> list[SceneObject]:
    """Cup, cup, table: of vertices 8 to 15, 16 to 23, 0 to 7."""
    found = []
    for label, first, score in (("cup", 8, 0.75), ("cup", 16, 0.5), ("café table", 0, 0.25)):
        vertices = np.arange(first, first + 8)
        points_m = mesh.vertices_m[vertices].astype(np.float64)
        lower_m, upper_m = points_m.min(axis=0), points_m.max(axis=0)
        thing = Instance((lower_m + upper_m) / 2, lower_m, upper_m, score, vertices)
        found.append(object_of(label, thing, mesh.vertices_m, UP, witnesses=vertices))
    return found


def scene_labels(mesh: Mesh) -> SurfaceLabels:
    """2 on the table, 1 on the cups, 0 on the rest."""
    return label_surface(len(mesh.vertices_m), scene_objects(mesh), TASK)
