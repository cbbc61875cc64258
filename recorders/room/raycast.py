"""Exact intersections of rays with the bodies of the room, in float64."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from recorders.room.compiled import compiled, compiled_parallel
from recorders.room.geometry import KIND, POSITION, ROTATION, SIZE, Geometry
from recorders.room.shapes import BOX, ELLIPSOID, FRUSTUM

NEAR = 1e-9
"""Smallest ray parameter that counts as a hit."""

MISS = math.inf
SEAM_M = 1e-9


Vector = tuple[float, float, float]


@compiled
def local_point(shape: np.ndarray, body: int, point: Vector) -> Vector:
    """A world point in the axes of a body; `shape` as in Geometry."""
    x, y, z = point
    x -= shape[body, POSITION]
    y -= shape[body, POSITION + 1]
    z -= shape[body, POSITION + 2]
    return local_direction(shape, body, (x, y, z))


@compiled
def local_direction(shape: np.ndarray, body: int, direction: Vector) -> Vector:
    """A world direction in the axes of a body."""
    x, y, z = direction
    r = ROTATION
    return (
        shape[body, r] * x + shape[body, r + 1] * y + shape[body, r + 2] * z,
        shape[body, r + 3] * x + shape[body, r + 4] * y + shape[body, r + 5] * z,
        shape[body, r + 6] * x + shape[body, r + 7] * y + shape[body, r + 8] * z,
    )


@compiled
def _inverse(value: float) -> float:
    return 1.0 / value if abs(value) > 1e-12 else math.copysign(1e12, value)


@compiled
def _hit_box(size: Vector, o: Vector, d: Vector) -> tuple[float, int]:
    ix, iy, iz = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    # The near and far planes of each pair are those that the ray's direction meets first and last.
    sx, sy, sz = math.copysign(size[0], ix), math.copysign(size[1], iy), math.copysign(size[2], iz)
    near, side = (-sx - o[0]) * ix, 0 if ix > 0.0 else 1
    near_y, near_z = (-sy - o[1]) * iy, (-sz - o[2]) * iz
    far = min((sx - o[0]) * ix, (sy - o[1]) * iy, (sz - o[2]) * iz)
    if near_y > near:
        near, side = near_y, 2 if iy > 0.0 else 3
    if near_z > near:
        near, side = near_z, 4 if iz > 0.0 else 5
    if near > far or near < NEAR:
        return MISS, 0
    return near, side


@compiled
def _hit_ellipsoid(size: Vector, o: Vector, d: Vector) -> tuple[float, int]:
    ox, oy, oz = o[0] / size[0], o[1] / size[1], o[2] / size[2]
    dx, dy, dz = d[0] / size[0], d[1] / size[1], d[2] / size[2]
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - 1.0
    root = b * b - a * c
    if root <= 0.0:
        return MISS, 0
    t = (-b - math.sqrt(root)) / a
    return (t, 0) if t >= NEAR else (MISS, 0)


@compiled
def _hit_frustum(size: Vector, o: Vector, d: Vector) -> tuple[float, int]:
    """The body is convex: of all valid crossings of the mantle, the first is the entrance."""
    bottom, top, half = size
    best = MISS
    if d[2] != 0.0:
        # Only the cap that faces the ray can be an entrance.
        radius, height, cap = (bottom, -half, 1) if d[2] > 0.0 else (top, half, 2)
        t = (height - o[2]) / d[2]
        x, y = o[0] + t * d[0], o[1] + t * d[1]
        if t >= NEAR and x * x + y * y <= radius * radius:
            return t, cap
    slope = (top - bottom) / (2.0 * half)
    start, step = (bottom + top) / 2.0 + slope * o[2], slope * d[2]
    a = d[0] * d[0] + d[1] * d[1] - step * step
    b = o[0] * d[0] + o[1] * d[1] - start * step
    c = o[0] * o[0] + o[1] * o[1] - start * start
    root = b * b - a * c
    if root > 0.0 and a != 0.0:
        reach = math.sqrt(root)
        for sign in range(2):
            t = (-b - reach) / a if sign == 0 else (-b + reach) / a
            if NEAR <= t < best and abs(o[2] + t * d[2]) <= half:
                best = t
    return best, 0


@compiled
def _hit_rectangle(size: Vector, o: Vector, d: Vector) -> tuple[float, int]:
    """Seen from +z only; a hair larger than it is, so that no ray slips through a seam."""
    if d[2] >= 0.0:
        return MISS, 0
    t = -o[2] / d[2]
    x, y = o[0] + t * d[0], o[1] + t * d[1]
    if t < NEAR or abs(x) > size[0] + SEAM_M or abs(y) > size[1] + SEAM_M:
        return MISS, 0
    return t, 0


@compiled
def hit_body(
    shape: np.ndarray, kind: np.ndarray, body: int, origin: Vector, ray: Vector
) -> tuple[float, int]:
    """Where a ray from outside enters a body: ray parameter (inf for a miss) and side."""
    o = local_point(shape, body, origin)
    d = local_direction(shape, body, ray)
    size = (shape[body, SIZE], shape[body, SIZE + 1], shape[body, SIZE + 2])
    which = kind[body, KIND]
    if which == BOX:
        return _hit_box(size, o, d)
    if which == ELLIPSOID:
        return _hit_ellipsoid(size, o, d)
    if which == FRUSTUM:
        return _hit_frustum(size, o, d)
    return _hit_rectangle(size, o, d)


@compiled
def trace(
    geometry: Geometry, origin: Vector, ray: Vector, limit: float, any_hit: bool
) -> tuple[float, int, int]:
    """The first body that a ray enters before the ray parameter `limit`.

    Returns:
        The ray parameter, the body and its side; `limit` and -1 where there is none. With
        `any_hit` the search ends at whatever it finds first.
    """
    boxes, links, order = geometry.node_box_m, geometry.node_link, geometry.order
    shape, kind = geometry.shape, geometry.kind
    ix, iy, iz = _inverse(ray[0]), _inverse(ray[1]), _inverse(ray[2])
    ox, oy, oz = origin
    # Columns of the corner that the ray meets first, and of the one that it meets last.
    x0, y0, z0 = 0 if ix > 0.0 else 3, 1 if iy > 0.0 else 4, 2 if iz > 0.0 else 5
    x1, y1, z1 = 3 - x0, 5 - y0, 7 - z0
    best, found, found_side = limit, -1, 0
    node, count = 0, len(links)
    while node < count:
        near = max(
            (boxes[node, x0] - ox) * ix, (boxes[node, y0] - oy) * iy, (boxes[node, z0] - oz) * iz
        )
        far = min(
            (boxes[node, x1] - ox) * ix, (boxes[node, y1] - oy) * iy, (boxes[node, z1] - oz) * iz
        )
        if near > far or far < 0.0 or near > best:
            node = links[node, 0]
            continue
        first = links[node, 1]
        for place in range(first, first + links[node, 2]):
            body = order[place]
            t, side = hit_body(shape, kind, body, origin, ray)
            if t < best:
                best, found, found_side = t, body, side
                if any_hit:
                    return best, found, found_side
        node += 1
    return best, found, found_side


@compiled_parallel
def cast(
    geometry: Geometry, origin_m: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cast rays [H, W, 3] from one point [3], world axes, float64.

    Returns:
        Ray parameters float64 [H, W] (0 where nothing is hit; depth along z for rays with z = 1
        in camera axes), bodies int64 [H, W] (-1 for nothing) and their sides int64 [H, W].
    """
    height, width = rays.shape[:2]
    depth = np.zeros((height, width))
    bodies = np.full((height, width), -1)
    sides = np.zeros((height, width), np.int64)
    origin = (origin_m[0], origin_m[1], origin_m[2])
    for row in prange(height):
        for column in range(width):
            ray = (rays[row, column, 0], rays[row, column, 1], rays[row, column, 2])
            t, body, side = trace(geometry, origin, ray, 1e6, False)
            if body >= 0:
                depth[row, column] = t
                bodies[row, column] = body
                sides[row, column] = side
    return depth, bodies, sides
