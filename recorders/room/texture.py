"""Procedural patterns: the colour of a surface at a point, in linear light."""

from __future__ import annotations

import math

from recorders.room.compiled import compiled
from recorders.room.geometry import KIND, PATTERN, RGB, SCALE, SECOND_RGB, SIZE, Geometry
from recorders.room.materials import (
    BRICK,
    CHECKER,
    FABRIC,
    PICTURE,
    PLANKS,
    SKY,
    STRIPES,
    TILES,
    WOOD,
)
from recorders.room.shapes import BOX, FRUSTUM, RECTANGLE

Rgb = tuple[float, float, float]


@compiled
def _hash(i: int, j: int, k: int) -> float:
    """A number in [0, 1) for a cell of a lattice."""
    h = (i * 374761393 + j * 668265263 + k * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1103515245) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return float((h ^ (h >> 15)) & 0xFFFFFF) / 16777216.0


@compiled
def _noise(x: float, y: float, k: int) -> float:
    """Smooth value noise in the plane, cells of size 1, in [0, 1); `k` chooses the plane."""
    i, j = math.floor(x), math.floor(y)
    x, y = x - i, y - j
    x, y = x * x * (3.0 - 2.0 * x), y * y * (3.0 - 2.0 * y)
    low = (1.0 - x) * _hash(i, j, k) + x * _hash(i + 1, j, k)
    high = (1.0 - x) * _hash(i, j + 1, k) + x * _hash(i + 1, j + 1, k)
    return (1.0 - y) * low + y * high


@compiled
def _solid_noise(x: float, y: float, z: float) -> float:
    """Smooth value noise in space, cells of size 1, in [0, 1)."""
    k = math.floor(z)
    z = z - k
    z = z * z * (3.0 - 2.0 * z)
    return (1.0 - z) * _noise(x, y, k) + z * _noise(x, y, k + 1)


@compiled
def _face(kind: int, side: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Two coordinates along a side, in metres; the second is up on upright sides."""
    if kind == RECTANGLE:
        return x, y
    if kind == BOX and side < 2:
        return y, z
    if kind == BOX and side > 3:
        return x, y
    if kind == FRUSTUM:
        return math.atan2(y, x) * 0.1, z
    return x, z


@compiled
def _grain(size_m: Rgb, scale_m: float, x: float, y: float, z: float) -> float:
    """Wood grain drawn out along the longest side, in [0, 1)."""
    fx, fy, fz = 1.0 / scale_m, 1.0 / scale_m, 1.0 / scale_m
    if size_m[0] >= size_m[1] and size_m[0] >= size_m[2]:
        fx *= 0.12
    elif size_m[1] >= size_m[2]:
        fy *= 0.12
    else:
        fz *= 0.12
    wide = _solid_noise(x * fx, y * fy + 7.3, z * fz)
    fine = _solid_noise(2.5 * x * fx + 3.1, 2.5 * y * fy, 2.5 * z * fz)
    return 0.65 * wide + 0.35 * fine


@compiled
def _courses(u: float, v: float, length_m: float, height_m: float) -> tuple[int, int, float]:
    """Row and number of the brick (or plank) at a point, and how far its edge is, in metres."""
    row = math.floor(v / height_m)
    shifted = u + length_m * (0.5 * (row % 2) + 0.35 * _hash(row, 5, 5) * (length_m > 1.0))
    column = math.floor(shifted / length_m)
    within_u, within_v = shifted - column * length_m, v - row * height_m
    edge_m = min(within_u, length_m - within_u, within_v, height_m - within_v)
    return row, column, edge_m


@compiled
def _landscape(variant: int, u: float, v: float, width_m: float, height_m: float) -> Rgb:
    """A painting: sky, sun, two ranges of hills and a field; u and v from -1 to 1."""
    x = u * width_m / height_m
    ridge = 0.05 + 0.5 * (_noise(1.6 * x + 9.0 * variant, 0.5, 0) - 0.4)
    hills = -0.35 + 0.4 * (_noise(1.1 * x + 5.0 * variant, 2.5, 0) - 0.4)
    warm = _hash(variant, 1, 2)
    if (x - 0.5 + warm) ** 2 + (v - 0.55) ** 2 < 0.05:
        return 0.95, 0.72, 0.15
    if v > ridge:
        t = 0.5 * (v + 1.0)
        return 0.85 - 0.6 * t * (1 - warm), 0.50 - 0.10 * t, 0.20 + 0.55 * t
    if v > hills:
        return 0.10 + 0.10 * warm, 0.16, 0.32 - 0.12 * warm
    stripes = 0.5 + 0.5 * math.sin(14.0 * v + 2.0 * x)
    return 0.35 * warm + 0.10 * stripes, 0.28 + 0.15 * stripes, 0.06


@compiled
def albedo(geometry: Geometry, body: int, side: int, x: float, y: float, z: float) -> Rgb:
    """Linear colour, 0 to 1, of the point (x, y, z), local metres, on a side of a body."""
    shape, paint = geometry.shape, geometry.paint
    pattern, scale_m = geometry.kind[body, PATTERN], paint[body, SCALE]
    size = (shape[body, SIZE], shape[body, SIZE + 1], shape[body, SIZE + 2])
    u, v = _face(geometry.kind[body, KIND], side, x, y, z)
    mix, tone = 0.0, 1.0
    if pattern == WOOD:
        mix = _grain(size, scale_m, x, y, z)
        tone = 1.1
    elif pattern == PLANKS:
        row, column, edge_m = _courses(u, v, 8.0 * scale_m, scale_m)
        mix = 0.6 * _hash(row, column, 1) + 0.4 * _noise(2.0 * u, v / (0.35 * scale_m), 0)
        tone = 0.72 if edge_m < 0.005 else 0.92 + 0.16 * _hash(row, column, 2)
    elif pattern == CHECKER:
        edge_m = min(size[0] - abs(x), size[1] - abs(y))
        squares = math.floor(u / scale_m) + math.floor(v / scale_m)
        mix = 1.0 if 0.06 < edge_m < 0.11 or (edge_m >= 0.11 and squares % 2 == 0) else 0.0
        tone = 0.9 + 0.2 * _noise(u / 0.05, v / 0.05, 0)
    elif pattern == BRICK:
        row, column, edge_m = _courses(u, v, scale_m, scale_m / 3.0)
        mix = 1.0 if edge_m < 0.007 else 0.25 * _hash(row, column, 3)
        tone = 0.75 + 0.4 * _hash(row, column, 4) + 0.1 * _noise(u / 0.06, v / 0.06, 0)
    elif pattern == TILES:
        row, column = math.floor(u / scale_m), math.floor(v / scale_m)
        edge_m = min(u - row * scale_m, v - column * scale_m)
        mix = 1.0 if edge_m < 0.012 else 0.0
        tone = 0.9 + 0.14 * _hash(row, column, 6)
    elif pattern == STRIPES:
        phase = u / scale_m - math.floor(u / scale_m)
        mix = 1.0 if phase < 0.5 else 0.0
        tone = 0.94 + 0.08 * _noise(u / 0.1, v / 0.15, 0)
    elif pattern == FABRIC:
        wide = _solid_noise(x / scale_m, y / scale_m, z / scale_m)
        tone = 0.72 + 0.5 * (0.6 * wide + 0.4 * _noise(u / 0.025, v / 0.025, 0))
    elif pattern == PICTURE:
        return _landscape(int(scale_m), x / size[0], z / size[2], size[0], size[2])
    elif pattern == SKY:
        height = z / size[2]
        cloud = _noise(3.0 * x, 5.0 * z, 0)
        mix = 1.0 if height < -0.55 + 0.25 * _noise(8.0 * x, 0.5, 0) else 0.0
        tone = 0.8 + 0.2 * cloud
    else:
        tone = 0.94 + 0.12 * _noise(u / 0.12, v / 0.12, side)
    r, g, b = paint[body, RGB], paint[body, RGB + 1], paint[body, RGB + 2]
    return (
        tone * (r + mix * (paint[body, SECOND_RGB] - r)),
        tone * (g + mix * (paint[body, SECOND_RGB + 1] - g)),
        tone * (b + mix * (paint[body, SECOND_RGB + 2] - b)),
    )
