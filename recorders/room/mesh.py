"""The labelled surface that the camera saw, as PLY."""

from __future__ import annotations

import numpy as np
from numba import prange

from proground_log.camera import Camera
from recorders.room.compiled import compiled_parallel
from recorders.room.geometry import Geometry, Grid
from recorders.room.light import shade
from recorders.room.raycast import trace
from recorders.room.render import ENCODE, LEVELS
from recorders.room.shapes import BOX, ELLIPSOID, FRUSTUM, SIDES
from recorders.room.surface import point_at, world_direction, world_point

VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("label", "<u2"),
        ("instance", "<u2"),
        ("n_views", "<u2"),
    ]
)
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])

HEADER = """ply
format binary_little_endian 1.0
element vertex {vertices}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property ushort label
property ushort instance
property ushort n_views
element face {faces}
property list uchar int vertex_indices
end_header
"""

SLACK_M = 1e-3
"""A vertex is seen unless something stands this much in front of it."""


def seen_mesh(
    geometry: Geometry,
    grid: Grid,
    light: np.ndarray,
    camera: Camera,
    poses: np.ndarray,
    labels: np.ndarray,
    instances: np.ndarray,
) -> bytes:
    """Binary PLY of the grid's faces whose three corners some view saw.

    Args:
        geometry, grid, light: the room, as from `pack`, `grid_points` and `bake`.
        camera: a pinhole camera.
        poses: world_from_camera of the views, float64 [N, 4, 4].
        labels, instances: of each body, uint16 [P].
    """
    points_m, normals, colors = _surface(geometry, grid, light, ENCODE)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height])
    n_views = _count_views(geometry, points_m, normals, lens, poses)
    faces = _faces(geometry, points_m)
    faces = faces[(n_views[faces] > 0).all(axis=1)]
    used, renumbered = np.unique(faces, return_inverse=True)
    vertices = np.empty(len(used), dtype=VERTEX)
    for axis, name in enumerate(("x", "y", "z")):
        vertices[name] = points_m[used, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = colors[used, channel]
    vertices["label"] = labels[grid.body[used]]
    vertices["instance"] = instances[grid.body[used]]
    vertices["n_views"] = n_views[used]
    triangles = np.empty(len(faces), dtype=FACE)
    triangles["count"] = 3
    triangles["corners"] = renumbered.reshape(-1, 3)
    header = HEADER.format(vertices=len(vertices), faces=len(triangles)).encode("ascii")
    return header + vertices.tobytes() + triangles.tobytes()


def _faces(geometry: Geometry, points_m: np.ndarray) -> np.ndarray:
    """Two triangles a grid cell, counter-clockwise from outside, int64 [F, 3]."""
    faces = []
    for kind, _, first_side in geometry.kind:
        for side in range(SIDES[int(kind)]):
            columns, rows, offset = geometry.sides[first_side + side]
            index = offset + np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
            a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
            c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
            cells = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
            faces.append(cells[:, ::-1] if _is_mirrored(int(kind), side) else cells)
    return _without_slivers(np.concatenate(faces), points_m)


def _is_mirrored(kind: int, side: int) -> bool:
    """Whether columns x rows of a side's grid point inwards."""
    mirrored = {BOX: (0, 2, 4), ELLIPSOID: (0,), FRUSTUM: (2,)}
    return side in mirrored.get(kind, ())


def _without_slivers(faces: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Leave out the empty triangles at poles and at the middle of discs."""
    a, b, c = points_m[faces[:, 0]], points_m[faces[:, 1]], points_m[faces[:, 2]]
    area_m2 = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.asarray(faces[area_m2 > 1e-9])


@compiled_parallel
def _surface(
    geometry: Geometry, grid: Grid, light: np.ndarray, encode: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World points and normals, float64 [G, 3], and colours, uint8 [G, 3], of the grid."""
    count = len(grid.body)
    points_m, normals = np.empty((count, 3)), np.empty((count, 3))
    colors = np.empty((count, 3), np.uint8)
    for index in prange(count):
        body, side = grid.body[index], grid.side[index]
        local, outward = point_at(geometry, body, side, grid.u[index], grid.v[index])
        point = world_point(geometry.shape, body, local)
        normal = world_direction(geometry.shape, body, outward)
        color = shade(geometry, light, body, side, local)
        for axis in range(3):
            points_m[index, axis] = point[axis]
            normals[index, axis] = normal[axis]
            level = min(int(color[axis] * LEVELS), len(encode) - 1)
            colors[index, axis] = encode[level]
    return points_m, normals, colors


@compiled_parallel
def _count_views(
    geometry: Geometry,
    points_m: np.ndarray,
    normals: np.ndarray,
    lens: np.ndarray,
    poses: np.ndarray,
) -> np.ndarray:
    """In how many views [N, 4, 4] each point is in the image and in plain sight, uint16 [G]."""
    count = np.zeros(len(points_m), np.uint16)
    fx, fy, cx, cy, width, height = lens
    for index in prange(len(points_m)):
        px, py, pz = points_m[index, 0], points_m[index, 1], points_m[index, 2]
        nx, ny, nz = normals[index, 0], normals[index, 1], normals[index, 2]
        for view in range(len(poses)):
            axes = poses[view]
            dx, dy, dz = px - axes[0, 3], py - axes[1, 3], pz - axes[2, 3]
            depth = dx * axes[0, 2] + dy * axes[1, 2] + dz * axes[2, 2]
            if depth <= 0.0 or dx * nx + dy * ny + dz * nz >= 0.0:
                continue
            u = cx + fx * (dx * axes[0, 0] + dy * axes[1, 0] + dz * axes[2, 0]) / depth
            v = cy + fy * (dx * axes[0, 1] + dy * axes[1, 1] + dz * axes[2, 1]) / depth
            if not (0.0 <= u < width and 0.0 <= v < height):
                continue
            origin = (axes[0, 3], axes[1, 3], axes[2, 3])
            if trace(geometry, origin, (dx, dy, dz), 1.0 - SLACK_M / depth, True)[1] < 0:
                count[index] += 1
    return count
