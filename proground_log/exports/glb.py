"""GLB, binary glTF 2.0: a coloured mesh for browsers, game engines and Blender."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from proground_log.exports.labels import SurfaceLabels
from proground_log.files import written_whole
from proground_log.mapping.boxes import upright_from_world
from proground_log.query.mesh import Mesh

Y_UP_FROM_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def write_glb(path: Path, mesh: Mesh, up: np.ndarray, labels: SurfaceLabels | None) -> None:
    """Write a mesh as GLB, whole or not at all.

    In glTF y is up. The vertices keep the world's axes; the node that holds them turns the
    world's upward direction to y.

    Args:
        path: the file, replaced if it is there.
        mesh: triangles with colours.
        up: the world's upward direction [3].
        labels: of the vertices; they then have the colours of their labels, and the mesh's
            `extras` say which names and colours ("#rrggbb") there are.
    """
    shape = trimesh.Trimesh(
        mesh.vertices_m,
        mesh.faces,
        vertex_normals=mesh.normals,
        vertex_colors=mesh.colors if labels is None else labels.colors(mesh.colors),
        process=False,
    )
    if labels is not None:
        named = zip(labels.names[1:], labels.palette[1:], strict=True)
        shape.metadata["labels"] = {name: f"#{bytes(color).hex()}" for name, color in named}
    scene = trimesh.Scene()
    turn = np.eye(4)
    turn[:3, :3] = Y_UP_FROM_Z_UP @ upright_from_world(up)
    scene.add_geometry(shape, node_name="map", geom_name="surface", transform=turn)
    with written_whole(path) as temporary:
        content = trimesh.exchange.gltf.export_glb(scene, include_normals=True)  # type: ignore[no-untyped-call]
        temporary.write_bytes(content)
