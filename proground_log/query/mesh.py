"""The surface of a map as a coloured mesh, where the sensor saw it."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
import trimesh
from skimage.measure import marching_cubes

from proground_log.mapping.map import Map

POINTS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class Mesh:
    """Triangles with colours.

    Args:
        vertices_m: float32 [V, 3], world axes.
        faces: int32 [F, 3], counter-clockwise seen from free space.
        normals: float32 [V, 3], unit length, towards free space.
        colors: uint8 [V, 3] RGB.
    """

    vertices_m: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colors: np.ndarray


def extract_mesh(mapped: Map, voxel_m: float) -> Mesh:
    """Marching cubes over the signed distances, near measured surface only.

    Args:
        mapped: the map.
        voxel_m: distance between the points at which the field is asked.

    Returns:
        The mesh; with no vertices where nothing was seen.
    """
    lower_m, size_m = np.array(mapped.bounds.lower_m), mapped.bounds.size_m
    counts = np.maximum(np.ceil(size_m / voxel_m).astype(int) + 1, 2)
    axes = [lower_m[i] + np.arange(counts[i]) * voxel_m for i in range(3)]
    near = mapped.near_surface(axes)
    sdf = np.ones(counts, np.float32)
    # Some at a time, so that of all points at once only the numbers are kept, not the places; not
    # slab by slab, since the hash grid is read once for all that are asked together.
    asked = np.flatnonzero(near)
    for start in range(0, len(asked), POINTS_AT_ONCE):
        part = np.unravel_index(asked[start : start + POINTS_AT_ONCE], near.shape)
        points_m = np.stack([axis_m[i] for axis_m, i in zip(axes, part, strict=True)], axis=-1)
        sdf[part] = mapped.signed_distance(points_m)
    try:
        vertices, faces, _, _ = marching_cubes(
            sdf,
            level=0.0,
            spacing=(voxel_m,) * 3,
            mask=_whole_cubes(near),
            gradient_direction="descent",
        )
    except (RuntimeError, ValueError):
        # So says skimage that no cube is crossed by a surface, or none at all is asked for.
        nothing = np.zeros((0, 3), np.float32)
        return Mesh(nothing, np.zeros((0, 3), np.int32), nothing, np.zeros((0, 3), np.uint8))
    vertices_m = (vertices + lower_m).astype(np.float32)
    colors = mapped.color(vertices_m)
    shape = trimesh.Trimesh(vertices_m, faces, process=False)
    return Mesh(
        vertices_m=vertices_m,
        faces=faces.astype(np.int32),
        # Of the faces: those of marching_cubes also look at points where nothing was asked.
        normals=np.asarray(shape.vertex_normals, dtype=np.float32),
        colors=(colors * 255).round().astype(np.uint8),
    )


def _whole_cubes(asked: np.ndarray) -> np.ndarray:
    """Mark the cubes of which every corner was asked, at their last corner, as skimage wants it."""
    whole = asked.copy()
    for axis in range(3):
        earlier = np.roll(whole, 1, axis=axis)
        np.moveaxis(earlier, axis, 0)[0] = False
        whole &= earlier
    return whole


def read_ply_vertices(content: bytes) -> np.ndarray:
    """The vertices [V, 3] of a PLY mesh."""
    mesh = trimesh.load_mesh(BytesIO(content), file_type="ply", process=False)
    return np.asarray(mesh.vertices)
