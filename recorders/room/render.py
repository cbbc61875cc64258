"""Pictures of the room: exact depth and bodies at pixel centres, colour averaged over the pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from proground_log.camera import Camera
from recorders.room.compiled import compiled, compiled_parallel
from recorders.room.geometry import Geometry
from recorders.room.light import shade_ray
from recorders.room.raycast import cast

LEVELS = 4096
"""Steps of the encoding table for one unit of light; it ends at four units."""


def _encoding() -> np.ndarray:
    """From linear light to sRGB bytes: straight up to 0.7, then bent towards white."""
    light = np.arange(4 * LEVELS) / LEVELS
    bent = np.where(light < 0.7, light, 0.7 + 0.3 * (1.0 - np.exp(-(light - 0.7) / 0.3)))
    return np.round(255.0 * bent ** (1 / 2.2)).astype(np.uint8)


ENCODE = _encoding()


@dataclass(frozen=True)
class View:
    """What a camera sees.

    Args:
        depth_m: along z at pixel centres, float64 [H, W], 0 where there is nothing.
        bodies: number of the body at the pixel's centre, int64 [H, W], -1 for none.
        sides: side of the body, int64 [H, W].
        rays: direction of each pixel's ray in world axes, depth 1 long, float64 [H, W, 3].
    """

    depth_m: np.ndarray
    bodies: np.ndarray
    sides: np.ndarray
    rays: np.ndarray


def look(geometry: Geometry, camera: Camera, world_from_camera: np.ndarray) -> View:
    """Cast one ray through each pixel's centre."""
    rays = camera.directions.astype(np.float64) @ world_from_camera[:3, :3].T
    rays = np.ascontiguousarray(rays)
    depth_m, bodies, sides = cast(geometry, world_from_camera[:3, 3].copy(), rays)
    return View(depth_m, bodies, sides, rays)


def paint(
    geometry: Geometry,
    light: np.ndarray,
    camera: Camera,
    world_from_camera: np.ndarray,
    view: View,
) -> np.ndarray:
    """Colour of a view, uint8 [H, W, 3] RGB, with `light` as from `bake`.

    Four samples a pixel at the outlines, two within a side.
    """
    axes = world_from_camera[:3, :3]
    right, down = axes[:, 0] * (0.25 / camera.fx), axes[:, 1] * (0.25 / camera.fy)
    eye = world_from_camera[:3, 3].copy()
    surface = view.bodies * 8 + view.sides
    return _paint(geometry, light, eye, view.rays, surface, right.copy(), down.copy(), ENCODE)


@compiled
def _is_plain(surface: np.ndarray, row: int, column: int) -> bool:
    """Whether the pixel and its four neighbours show one side of one body.

    Bodies are convex, so that the samples within the pixel then meet that body too.
    """
    height, width = surface.shape
    if row == 0 or column == 0 or row == height - 1 or column == width - 1:
        return False
    here = surface[row, column]
    return bool(
        here >= 0
        and here == surface[row - 1, column]
        and here == surface[row + 1, column]
        and here == surface[row, column - 1]
        and here == surface[row, column + 1]
    )


@compiled_parallel
def _paint(
    geometry: Geometry,
    light: np.ndarray,
    eye: np.ndarray,
    rays: np.ndarray,
    surface: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    encode: np.ndarray,
) -> np.ndarray:
    height, width = surface.shape
    image = np.zeros((height, width, 3), np.uint8)
    origin = (eye[0], eye[1], eye[2])
    for row in prange(height):
        for column in range(width):
            plain = _is_plain(surface, row, column)
            known = surface[row, column] // 8 if plain else -1
            r, g, b = 0.0, 0.0, 0.0
            for sample in range(0, 4, 3 if plain else 1):
                i, j = 2.0 * (sample % 2) - 1.0, 2.0 * (sample // 2) - 1.0
                ray = (
                    rays[row, column, 0] + i * right[0] + j * down[0],
                    rays[row, column, 1] + i * right[1] + j * down[1],
                    rays[row, column, 2] + i * right[2] + j * down[2],
                )
                color = shade_ray(geometry, light, origin, ray, known)
                r, g, b = r + color[0], g + color[1], b + color[2]
            level = LEVELS * (0.5 if plain else 0.25)
            top = len(encode) - 1
            image[row, column, 0] = encode[min(int(r * level), top)]
            image[row, column, 1] = encode[min(int(g * level), top)]
            image[row, column, 2] = encode[min(int(b * level), top)]
    return image
