"""What a structured-light sensor does to an exact view."""

from __future__ import annotations

import numpy as np

COLOR_SIGMA = 2.0
"""Standard deviation of the colour noise, in steps of 255."""

EDGE_RATIO = 0.05
"""Neighbours whose depths differ by more than this share lie across an edge."""

GRAZING_COSINE = 0.2
DROP_AT_EDGE, DROP_AT_GRAZING = 0.6, 0.7


def noisy_depth(depth_m: np.ndarray, rays: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth [H, W] in metres with noise that grows as z squared, and holes (0).

    The noise is 1.425e-3 z^2, as Khoshelham and Elberink (2012) measured for a Kinect, on a small
    floor; pixels drop out at depth edges and where the surface is seen at a grazing angle.

    Args:
        depth_m: exact depth along z, float64 [H, W].
        rays: each pixel's ray, depth 1 long, float64 [H, W, 3].
        rng: the frame's own generator.
    """
    sigma_m = 0.0005 + 1.425e-3 * depth_m**2
    noisy_m = depth_m + sigma_m * rng.standard_normal(depth_m.shape)
    chance = rng.uniform(size=depth_m.shape)
    dropped = _is_edge(depth_m) & (chance < DROP_AT_EDGE)
    dropped |= _is_grazing(depth_m, rays) & (chance < DROP_AT_GRAZING)
    return np.where(dropped | (depth_m == 0.0), 0.0, np.maximum(noisy_m, 0.0))


def noisy_color(color: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Colour uint8 [H, W, 3] with a little noise."""
    noise = COLOR_SIGMA * rng.standard_normal(color.shape)
    return np.clip(np.round(color + noise), 0, 255).astype(np.uint8)


def _is_edge(depth_m: np.ndarray) -> np.ndarray:
    """Pixels beside a step in depth, bool [H, W]."""
    edge = np.zeros(depth_m.shape, dtype=bool)
    for axis in (0, 1):
        near = np.moveaxis(depth_m, axis, 0)
        step = np.abs(np.diff(near, axis=0)) > EDGE_RATIO * np.minimum(near[1:], near[:-1])
        view = np.moveaxis(edge, axis, 0)
        view[1:] |= step
        view[:-1] |= step
    return edge


def _is_grazing(depth_m: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Pixels whose surface is nearly along the ray, bool [H, W]."""
    points_m = rays * depth_m[..., None]
    normals = np.cross(np.gradient(points_m, axis=1), np.gradient(points_m, axis=0))
    along = np.abs(np.sum(normals * rays, axis=-1))
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(rays, axis=-1)
    return np.asarray(along < GRAZING_COSINE * lengths)
