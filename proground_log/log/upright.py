"""Which way is up: neither logs nor poses say so, but cameras are held, and floors lie, level."""

from __future__ import annotations

import numpy as np

LOOKING_DOWN = 0.4
"""Weight of the view's direction in the guess: cameras look down at tables, where the image's up
leans towards the horizon, more than up at ceilings."""
PORTRAIT_MARGIN = 0.3
"""How much steadier the image's side has to be than its top before a camera is taken for a phone
held upright: while it looks round, what points up stays and what points sideways turns."""
CONES_DEG = (40.0, 25.0, 15.0, 8.0, 4.0)
"""Floors and tables are looked for within these angles of up, one after the other; walls, 90
degrees away, are never among them."""
AXIS_CONES_DEG = CONES_DEG[2:]
"""Where a world's axis is up, floors are at right angles to it."""
MOST_ROLL_DEG = 60.0
"""A world's axis that is farther from the guess is not up."""
AXIS_BONUS = 1.5
"""Most worlds are level: how much more the floors of a world's axis count."""
LEAST_SHARE = 0.02
"""A floor or table has at least this share of the surface."""
JUMP_SHARE = 0.05
"""Neighbours whose depths differ by more than this share lie on two surfaces."""


def up_direction(poses: np.ndarray) -> np.ndarray:
    """About the world's upward direction, of length 1, float64 [3], by how the camera was held.

    Args:
        poses: world_from_camera, [P, 4, 4], camera axes x right, y down, z forward.
    """
    left, top, forward = -poses[:, :3, 0], -poses[:, :3, 1], poses[:, :3, 2]
    steadiness = [np.linalg.norm(side.mean(axis=0)) for side in (left, top)]
    # Phones have their images' left above when they are held upright.
    held = left if steadiness[0] > steadiness[1] + PORTRAIT_MARGIN else top
    return _unit((held - LOOKING_DOWN * forward).mean(axis=0))


def nearest_axis(up: np.ndarray) -> tuple[int, int]:
    """The world's axis nearest to a direction [3], and its sign."""
    axis = int(np.abs(up).argmax())
    return axis, 1 if up[axis] > 0 else -1


def levelled(guess: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The upward direction, of length 1, float64 [3]: that of most of the level surface.

    Args:
        guess: about upward, [3]; kept where no floor or table was seen.
        normals: of the surface, towards the camera, world axes, [N, 3].
    """
    candidates: list[tuple[np.ndarray, tuple[float, ...], float]] = [(guess, CONES_DEG, 1.0)]
    for axis in (*np.eye(3), *-np.eye(3)):
        if axis @ guess > np.cos(np.radians(MOST_ROLL_DEG)):
            candidates.append((axis, AXIS_CONES_DEG, AXIS_BONUS))
    best, most = guess, LEAST_SHARE
    for start, cones_deg, bonus in candidates:
        up = start
        for cone_deg in cones_deg:
            level = normals[_within(cone_deg, up, normals)]
            up = _unit(level.mean(axis=0)) if len(level) else up
        share = bonus * float(np.mean(_within(cones_deg[-1], up, normals))) if len(normals) else 0.0
        if share > most:
            best, most = up, share
    return best


def surface_normals(points_m: np.ndarray, reach: int) -> np.ndarray:
    """Normals of the surface that a depth image shows, towards the camera, [H, W, 3].

    Args:
        points_m: what its pixels see in camera axes, [H, W, 3]; z is 0 where nothing was measured.
        reach: pixels to the neighbours that a normal is made of: few of them, and noise prevails.

    Returns:
        Normals of length 1; 0 where none is known, as beside a jump of depth.
    """
    normals = np.zeros_like(points_m)
    here = points_m[:-reach, :-reach]
    right, below = points_m[:-reach, reach:], points_m[reach:, :-reach]
    made = np.cross(below - here, right - here)
    steps = np.maximum(np.abs(right - here)[..., 2], np.abs(below - here)[..., 2])
    lengths = np.linalg.norm(made, axis=-1)
    known = (here[..., 2] > 0) & (steps < JUMP_SHARE * here[..., 2]) & (lengths > 0)
    normals[:-reach, :-reach][known] = made[known] / lengths[known, None]
    return normals


def _within(cone_deg: float, direction: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return np.asarray(normals @ direction > np.cos(np.radians(cone_deg)))


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))
