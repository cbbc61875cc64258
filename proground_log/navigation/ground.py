"""The floor as a plane with axes of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proground_log.errors import ProgroundError

SNAP_DEG = 3.0
"""A world whose axis is up but for this much was meant to be level: its own axes are kept."""
LEVEL = np.cos(np.radians(25.0))
"""Least cosine between up and the normal of what one can stand on."""
BIN_M = 0.025
DOMINANT = 0.25
"""A floor has at least this share of the area of the largest level."""


@dataclass(frozen=True)
class Ground:
    """A plane that is level, and its axes.

    Args:
        plan_from_world: float64 [3, 3], a rotation; its rows are the plan's x and y, seen from
            above as on paper, and up.
        floor_m: height of the floor, along up.
    """

    plan_from_world: np.ndarray
    floor_m: float

    def plan(self, points_m: np.ndarray) -> np.ndarray:
        """Where points [..., 3] of the world are on the plan, [..., 2]."""
        return np.asarray(points_m @ self.plan_from_world[:2].T)

    def height(self, points_m: np.ndarray) -> np.ndarray:
        """How high points [..., 3] of the world are above the floor, [...]."""
        return np.asarray(points_m @ self.plan_from_world[2] - self.floor_m)

    def world(self, places_m: np.ndarray, height_m: float = 0.0) -> np.ndarray:
        """Points [..., 3] of the world above places [..., 2] of the plan."""
        above = np.full((*places_m.shape[:-1], 1), self.floor_m + height_m)
        return np.asarray(np.concatenate([places_m, above], axis=-1) @ self.plan_from_world)

    @property
    def axis_names(self) -> tuple[str, str]:
        """What the plan's axes are called: x, y or z where they are the world's."""
        names = []
        for row, plain in zip(self.plan_from_world[:2], ("plan x", "plan y"), strict=True):
            axis = int(np.abs(row).argmax())
            names.append("xyz"[axis] if row[axis] == 1.0 else plain)
        return names[0], names[1]


def find_ground(vertices_m: np.ndarray, faces: np.ndarray, up: np.ndarray) -> Ground:
    """The lowest of the large level surfaces.

    Args:
        vertices_m: [V, 3], world axes.
        faces: int [F, 3], counter-clockwise seen from free space.
        up: the world's upward direction [3].

    Raises:
        ProgroundError: nothing in the mesh is level and faces up.
    """
    rotation = _plan_axes(up)
    corners_m = vertices_m[faces].astype(np.float64)
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    level = normals @ rotation[2] > LEVEL * areas
    if not areas[level].sum() > 0:
        raise ProgroundError(
            "the map shows no floor",
            where="navigate",
            todo="map frames in which the camera saw the floor, and check which way is up",
        )
    heights_m, areas = corners_m[level].mean(axis=1) @ rotation[2], areas[level]
    return Ground(rotation, _lowest_level(heights_m, areas))


def level_faces(ground: Ground, corners_m: np.ndarray) -> np.ndarray:
    """Which faces, by their corners [F, 3, 3], one can stand on, bool [F]."""
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    return np.asarray(normals @ ground.plan_from_world[2] > LEVEL * np.linalg.norm(normals, axis=1))


def _plan_axes(up: np.ndarray) -> np.ndarray:
    """Rows x, y and up; the axes of the world in their cyclic order where it is level."""
    up = np.asarray(up, np.float64) / np.linalg.norm(up)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > np.cos(np.radians(SNAP_DEG)):
        up = np.sign(up[axis]) * np.eye(3)[axis]
    first, second = (axis + 1) % 3, (axis + 2) % 3
    x = np.eye(3)[first if up[axis] > 0 else second]
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    # Adding 0 makes 0 of -0.
    return np.stack([x, np.cross(up, x), up]) + 0.0


def _lowest_level(heights_m: np.ndarray, areas: np.ndarray) -> float:
    """Height of the lowest dominant level: reflections and specks below it are small."""
    lowest_m = heights_m.min() - BIN_M
    bins = ((heights_m - lowest_m) / BIN_M).astype(int)
    # Two bins to either side, since a floor seldom keeps to one.
    by_height = np.convolve(np.bincount(bins, areas), np.ones(5), mode="same")
    first = int(np.flatnonzero(by_height >= DOMINANT * by_height.max())[0])
    # From there on up to the top of the hill.
    while first + 1 < len(by_height) and by_height[first + 1] > by_height[first]:
        first += 1
    near = np.abs(bins - first) <= 2
    order = np.argsort(heights_m[near], kind="stable")
    cumulated = np.cumsum(areas[near][order])
    middle = int(np.searchsorted(cumulated, cumulated[-1] / 2))
    return float(heights_m[near][order][middle])
