"""The grid on each side of a body: where its points lie, and where a point lies on it."""

from __future__ import annotations

import math

import numpy as np

from recorders.room.compiled import compiled
from recorders.room.geometry import KIND, POSITION, ROTATION, SIZE, Geometry
from recorders.room.shapes import BOX, ELLIPSOID, FRUSTUM

Vector = tuple[float, float, float]


@compiled
def point_at(geometry: Geometry, body: int, side: int, u: float, v: float) -> tuple[Vector, Vector]:
    """Point and outward unit normal, local axes, at u (columns) and v (rows) from 0 to 1."""
    a, b, c = _size(geometry.shape, body)
    kind = geometry.kind[body, KIND]
    turn = 2.0 * math.pi * u
    if kind == BOX:
        return _point_on_box(a, b, c, side, 2.0 * u - 1.0, 2.0 * v - 1.0)
    if kind == ELLIPSOID:
        ring = math.sin(math.pi * v)
        x, y, z = ring * math.cos(turn), ring * math.sin(turn), math.cos(math.pi * v)
        length = math.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
        return (a * x, b * y, c * z), (x / a / length, y / b / length, z / c / length)
    if kind == FRUSTUM:
        x, y = math.cos(turn), math.sin(turn)
        if side == 0:
            radius = a + v * (b - a)
            length = math.hypot(2.0 * c, a - b)
            out, up = 2.0 * c / length, (a - b) / length
            return (radius * x, radius * y, (2.0 * v - 1.0) * c), (out * x, out * y, up)
        radius, sign = (v * a, -1.0) if side == 1 else (v * b, 1.0)
        return (radius * x, radius * y, sign * c), (0.0, 0.0, sign)
    return ((2.0 * u - 1.0) * a, (2.0 * v - 1.0) * b, 0.0), (0.0, 0.0, 1.0)


@compiled
def _point_on_box(
    a: float, b: float, c: float, side: int, p: float, q: float
) -> tuple[Vector, Vector]:
    """p and q run along the next and the next but one axis after the side's own."""
    sign = -1.0 if side % 2 == 0 else 1.0
    if side < 2:
        return (sign * a, p * b, q * c), (sign, 0.0, 0.0)
    if side < 4:
        return (q * a, sign * b, p * c), (0.0, sign, 0.0)
    return (p * a, q * b, sign * c), (0.0, 0.0, sign)


@compiled
def place_on(
    geometry: Geometry, body: int, side: int, x: float, y: float, z: float
) -> tuple[float, float]:
    """u and v, 0 to 1, of a local point on a side: the inverse of `point_at`."""
    a, b, c = _size(geometry.shape, body)
    kind = geometry.kind[body, KIND]
    if kind == BOX:
        u, v = _place_on_box(x / a, y / b, z / c, side)
    elif kind == ELLIPSOID:
        u = _turns(x / a, y / b)
        v = math.acos(min(1.0, max(-1.0, z / c))) / math.pi
    elif kind == FRUSTUM:
        u, radius = _turns(x, y), math.sqrt(x * x + y * y)
        v = 0.5 * (z / c + 1.0) if side == 0 else radius / (a if side == 1 else b)
    else:
        u, v = 0.5 * (x / a + 1.0), 0.5 * (y / b + 1.0)
    return min(1.0, max(0.0, u)), min(1.0, max(0.0, v))


@compiled
def _place_on_box(p: float, q: float, r: float, side: int) -> tuple[float, float]:
    if side < 2:
        return 0.5 * (q + 1.0), 0.5 * (r + 1.0)
    if side < 4:
        return 0.5 * (r + 1.0), 0.5 * (p + 1.0)
    return 0.5 * (p + 1.0), 0.5 * (q + 1.0)


@compiled
def _turns(x: float, y: float) -> float:
    turn = math.atan2(y, x) / (2.0 * math.pi)
    return turn + 1.0 if turn < 0.0 else turn


@compiled
def _size(shape: np.ndarray, body: int) -> Vector:
    return shape[body, SIZE], shape[body, SIZE + 1], shape[body, SIZE + 2]


@compiled
def world_point(shape: np.ndarray, body: int, local: Vector) -> Vector:
    """A local point in world axes; `shape` as in Geometry."""
    x, y, z = world_direction(shape, body, local)
    p = POSITION
    return x + shape[body, p], y + shape[body, p + 1], z + shape[body, p + 2]


@compiled
def world_direction(shape: np.ndarray, body: int, local: Vector) -> Vector:
    """A local direction in world axes."""
    x, y, z = local
    r = ROTATION
    return (
        shape[body, r] * x + shape[body, r + 3] * y + shape[body, r + 6] * z,
        shape[body, r + 1] * x + shape[body, r + 4] * y + shape[body, r + 7] * z,
        shape[body, r + 2] * x + shape[body, r + 5] * y + shape[body, r + 8] * z,
    )
