"""PLY, binary little endian: a coloured mesh or point cloud, with labels where there are some."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from proground_log.exports.labels import SurfaceLabels
from proground_log.files import written_whole
from proground_log.query.mesh import Mesh

_FORMAT_LINE = b"format binary_little_endian 1.0\n"


def write_mesh_ply(path: Path, mesh: Mesh, labels: SurfaceLabels | None) -> None:
    """Write a mesh as PLY, whole or not at all.

    Args:
        path: the file, replaced if it is there.
        mesh: triangles; vertices have x, y, z, nx, ny, nz, red, green, blue and alpha.
        labels: of the vertices; they then have the colours of their labels, and `label`,
            `instance` (ushort) and `score` (float) besides. The header names each label in a
            comment, such as `comment label 3 coffee table`.
    """
    colors = mesh.colors if labels is None else labels.colors(mesh.colors)
    shape = trimesh.Trimesh(
        mesh.vertices_m,
        mesh.faces,
        vertex_normals=mesh.normals,
        vertex_colors=colors,
        process=False,
    )
    _write(path, shape, labels, with_normals=True)


def write_points_ply(path: Path, mesh: Mesh, labels: SurfaceLabels) -> None:
    """Write a mesh's vertices as a point cloud, whole or not at all: the map's own colours, and
    `label`, `instance` and `score` as `write_mesh_ply` has them."""
    no_faces = np.zeros((0, 3), np.int32)
    shape = trimesh.Trimesh(mesh.vertices_m, no_faces, vertex_colors=mesh.colors, process=False)
    _write(path, shape, labels, with_normals=False)


def _write(
    path: Path, shape: trimesh.Trimesh, labels: SurfaceLabels | None, *, with_normals: bool
) -> None:
    comments = b""
    if labels is not None:
        shape.vertex_attributes["label"] = labels.labels
        shape.vertex_attributes["instance"] = labels.instances
        shape.vertex_attributes["score"] = labels.scores
        lines = [f"comment label {number} {name}\n" for number, name in enumerate(labels.names)]
        comments = "".join(lines).encode("ascii", "backslashreplace")
    content = trimesh.exchange.ply.export_ply(shape, vertex_normal=with_normals)
    with written_whole(path) as temporary:
        temporary.write_bytes(content.replace(_FORMAT_LINE, _FORMAT_LINE + comments, 1))
