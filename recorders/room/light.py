"""Light that falls on every surface: windows and lamps with soft shadows, and one bounce.

It is computed once, on the grids of `surface.py`, and does not depend on where one looks from: a
map can learn it as colour.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from recorders.room.compiled import compiled, compiled_parallel
from recorders.room.geometry import COLUMNS, EMISSION, FIRST_SIDE, OFFSET, ROWS, Geometry, Grid
from recorders.room.raycast import hit_body, local_point, trace
from recorders.room.surface import place_on, point_at, world_direction, world_point
from recorders.room.texture import albedo

INSET_M = 0.01
"""Points on an edge take the light of a point a little inside, where no neighbour touches."""

LIFT_M = 1e-4
BOUNCE_RAYS = 20
AMBIENT = 0.12
BOUNCE_GAIN = 1.25
"""Makes up for all bounces after the first."""


def lamps() -> np.ndarray:
    """Small light sources: position [m], direction, and intensity, float64 [L, 9]."""
    day, warm, white = (1.0, 1.04, 1.12), (1.0, 0.86, 0.66), (1.0, 0.97, 0.92)
    rows: list[tuple[float, ...]] = []
    for i in range(3):
        for j in range(2):
            along, up = (i - 1.0) * 0.4, (j - 0.5) * 0.5
            west = (0.12, 4.15 + along, 1.72 + up, 1.0, 0.0, 0.0)
            east = (5.88, 3.35 + along, 1.62 + up, -1.0, 0.0, 0.0)
            panel = (2.4 + 0.55 * (i - 1), 2.4 + 0.9 * (j - 0.5), 2.66, 0.0, 0.0, -1.0)
            rows += [(*west, *_scaled(day, 0.55)), (*east, *_scaled(day, 0.55))]
            rows.append((*panel, *_scaled(white, 0.45)))
    for x, y, z, power in ((4.75, 1.35, 1.90, 0.55), (0.38, 0.42, 1.33, 0.28)):
        for i in range(3):
            dx, dy = 0.08 * math.cos(i * math.pi / 1.5), 0.08 * math.sin(i * math.pi / 1.5)
            rows.append((x + dx, y + dy, z, 0.0, 0.0, -1.0, *_scaled(warm, power / 3)))
    return np.array(rows)


def _scaled(rgb: tuple[float, float, float], power: float) -> tuple[float, float, float]:
    r, g, b = rgb
    return r * power, g * power, b * power


def bounce_directions() -> np.ndarray:
    """Directions about +z with the density of Lambert's cosine, on a golden spiral, [N, 3]."""
    i = np.arange(BOUNCE_RAYS) + 0.5
    radius, turn = np.sqrt(i / BOUNCE_RAYS), i * math.pi * (3.0 - math.sqrt(5.0))
    height = np.sqrt(1.0 - radius**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def bake(geometry: Geometry, grid: Grid) -> np.ndarray:
    """Light that reaches each grid point, float64 [G, 3]; times the albedo it is the colour."""
    direct = _direct(geometry, grid, lamps())
    return _with_bounce(geometry, grid, direct, bounce_directions())


@compiled
def _lifted(
    geometry: Geometry, grid: Grid, index: int
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Grid point just above the surface, inset from its edges, and its normal; world axes."""
    body, side = grid.body[index], grid.side[index]
    inner = 0.02
    u = min(1.0 - inner, max(inner, grid.u[index]))
    v = min(1.0 - inner, max(inner, grid.v[index]))
    low, _ = point_at(geometry, body, side, 0.0, 0.5)
    high, _ = point_at(geometry, body, side, 1.0, 0.5)
    reach_m = math.sqrt((high[0] - low[0]) ** 2 + (high[1] - low[1]) ** 2 + (high[2] - low[2]) ** 2)
    if reach_m > INSET_M / inner:
        u = min(1.0 - INSET_M / reach_m, max(INSET_M / reach_m, grid.u[index]))
    local, normal = point_at(geometry, body, side, u, v)
    x, y, z = local
    nx, ny, nz = normal
    raised = (x + LIFT_M * nx, y + LIFT_M * ny, z + LIFT_M * nz)
    return world_point(geometry.shape, body, raised), world_direction(geometry.shape, body, normal)


@compiled_parallel
def _direct(geometry: Geometry, grid: Grid, sources: np.ndarray) -> np.ndarray:
    light = np.zeros((len(grid.body), 3))
    for index in prange(len(grid.body)):
        p, n = _lifted(geometry, grid, index)
        for s in range(len(sources)):
            dx, dy, dz = sources[s, 0] - p[0], sources[s, 1] - p[1], sources[s, 2] - p[2]
            distance2 = dx * dx + dy * dy + dz * dz
            facing = dx * n[0] + dy * n[1] + dz * n[2]
            leaving = -(dx * sources[s, 3] + dy * sources[s, 4] + dz * sources[s, 5])
            if facing <= 0.0 or leaving <= 0.0:
                continue
            if trace(geometry, p, (dx, dy, dz), 1.0, True)[1] >= 0:
                continue
            weight = facing * leaving / (distance2 * (distance2 + 0.15))
            for channel in range(3):
                light[index, channel] += weight * sources[s, 6 + channel]
    return light


@compiled_parallel
def _with_bounce(
    geometry: Geometry, grid: Grid, direct: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    light = np.empty_like(direct)
    for index in prange(len(grid.body)):
        p, n = _lifted(geometry, grid, index)
        sign = 1.0 if n[2] >= 0.0 else -1.0
        # Two axes across the normal without a branch at the poles (Duff et al., JCGT 2017).
        a = -1.0 / (sign + n[2])
        b = n[0] * n[1] * a
        right = (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0])
        up = (b, sign + n[1] * n[1] * a, -n[1])
        r, g, bl = 0.0, 0.0, 0.0
        for k in range(len(directions)):
            x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
            ray = (
                x * right[0] + y * up[0] + z * n[0],
                x * right[1] + y * up[1] + z * n[1],
                x * right[2] + y * up[2] + z * n[2],
            )
            t, body, side = trace(geometry, p, ray, 1e6, False)
            if body < 0:
                continue
            hit = (p[0] + t * ray[0], p[1] + t * ray[1], p[2] + t * ray[2])
            local = local_point(geometry.shape, body, hit)
            color = albedo(geometry, body, side, local[0], local[1], local[2])
            e = light_at(geometry, direct, body, side, local)
            r += color[0] * (e[0] + AMBIENT)
            g += color[1] * (e[1] + AMBIENT)
            bl += color[2] * (e[2] + AMBIENT)
        gain = BOUNCE_GAIN / len(directions)
        light[index, 0] = direct[index, 0] + gain * r
        light[index, 1] = direct[index, 1] + gain * g
        light[index, 2] = direct[index, 2] + gain * bl
    return light


@compiled
def light_at(
    geometry: Geometry,
    light: np.ndarray,
    body: int,
    side: int,
    local: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Baked light [G, 3] at a local point, bilinear between the four grid points around it."""
    u, v = place_on(geometry, body, side, local[0], local[1], local[2])
    row = geometry.kind[body, FIRST_SIDE] + side
    columns, rows = geometry.sides[row, COLUMNS], geometry.sides[row, ROWS]
    x, y = u * columns, v * rows
    i, j = min(int(x), columns - 1), min(int(y), rows - 1)
    x, y = x - i, y - j
    c00 = geometry.sides[row, OFFSET] + j * (columns + 1) + i
    c01 = c00 + columns + 1
    w00, w10, w01, w11 = (1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y
    k, m = c00 + 1, c01 + 1
    return (
        w00 * light[c00, 0] + w10 * light[k, 0] + w01 * light[c01, 0] + w11 * light[m, 0],
        w00 * light[c00, 1] + w10 * light[k, 1] + w01 * light[c01, 1] + w11 * light[m, 1],
        w00 * light[c00, 2] + w10 * light[k, 2] + w01 * light[c01, 2] + w11 * light[m, 2],
    )


@compiled
def shade(
    geometry: Geometry,
    light: np.ndarray,
    body: int,
    side: int,
    local: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Linear colour that a local point on a side sends out, the same in every direction."""
    color = albedo(geometry, body, side, local[0], local[1], local[2])
    e = light_at(geometry, light, body, side, local)
    glow = geometry.paint[body, EMISSION]
    return color[0] * (e[0] + glow), color[1] * (e[1] + glow), color[2] * (e[2] + glow)


@compiled
def shade_ray(
    geometry: Geometry,
    light: np.ndarray,
    origin: tuple[float, float, float],
    ray: tuple[float, float, float],
    known: int,
) -> tuple[float, float, float]:
    """Linear colour along a ray; `known` is the body it is sure to meet, or -1."""
    if known >= 0:
        t, side = hit_body(geometry.shape, geometry.kind, known, origin, ray)
        body = known if t < 1e6 else -1
    else:
        t, body, side = trace(geometry, origin, ray, 1e6, False)
    if body < 0:
        return 0.0, 0.0, 0.0
    hit = (origin[0] + t * ray[0], origin[1] + t * ray[1], origin[2] + t * ray[2])
    local = local_point(geometry.shape, body, hit)
    return shade(geometry, light, body, side, local)
