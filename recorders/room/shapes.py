"""The convex bodies that everything in the room is built of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from recorders.room.materials import Material

BOX, ELLIPSOID, FRUSTUM, RECTANGLE = range(4)
SIDES = {BOX: 6, ELLIPSOID: 1, FRUSTUM: 3, RECTANGLE: 1}
"""Smooth patches of each kind. Box: -x +x -y +y -z +z; frustum: mantle, bottom, top."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Primitive:
    """A convex body, in its own axes centred on the origin.

    Args:
        kind: BOX, ELLIPSOID, FRUSTUM (along z) or RECTANGLE (in the plane z = 0, seen from +z).
        world_from_local: rigid, float64 [4, 4].
        size_m: half sides of a box; semi-axes of an ellipsoid; bottom radius, top radius and
            half height of a frustum; half sides, and 0, of a rectangle.
        material: of the whole surface.
    """

    kind: int
    world_from_local: np.ndarray
    size_m: Vector
    material: Material

    def moved(self, target_from_world: np.ndarray) -> Primitive:
        """The same body after a rigid motion [4, 4]."""
        return replace(self, world_from_local=target_from_world @ self.world_from_local)

    def aabb(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner, float64 [3], of the tightest box along the world's axes."""
        rotation, center = self.world_from_local[:3, :3], self.world_from_local[:3, 3]
        if self.kind == FRUSTUM:
            bottom_m, top_m, half_m = self.size_m
            axis = rotation[:, 2]
            disc = np.sqrt(np.maximum(1.0 - axis**2, 0.0))
            ends = np.stack([center - half_m * axis, center + half_m * axis])
            reach = np.stack([bottom_m * disc, top_m * disc])
            return (ends - reach).min(axis=0), (ends + reach).max(axis=0)
        spread = rotation * np.array(self.size_m)
        reach = np.linalg.norm(spread, axis=1) if self.kind == ELLIPSOID else abs(spread).sum(1)
        return center - reach, center + reach


def pose(center_m: Vector, turn_deg: Vector = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A 4x4 pose: turned about its own x, then y, then z, and moved."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    matrix[:3, 3] = center_m
    return matrix


def box(
    material: Material, center_m: Vector, sides_m: Vector, turn_deg: Vector = (0.0, 0.0, 0.0)
) -> Primitive:
    """A box by its centre and full side lengths."""
    x, y, z = sides_m
    return Primitive(BOX, pose(center_m, turn_deg), (x / 2, y / 2, z / 2), material)


def ellipsoid(
    material: Material, center_m: Vector, radii_m: Vector, turn_deg: Vector = (0.0, 0.0, 0.0)
) -> Primitive:
    """An ellipsoid by its centre and semi-axes."""
    return Primitive(ELLIPSOID, pose(center_m, turn_deg), radii_m, material)


def frustum(
    material: Material, base_m: Vector, bottom_m: float, top_m: float, height_m: float
) -> Primitive:
    """An upright cylinder or truncated cone by the centre of its base, radii and height."""
    x, y, z = base_m
    half = height_m / 2
    return Primitive(FRUSTUM, pose((x, y, z + half)), (bottom_m, top_m, half), material)


def rod(material: Material, start_m: Vector, end_m: Vector, radius_m: float) -> Primitive:
    """A cylinder between two points."""
    start, end = np.array(start_m), np.array(end_m)
    length_m = float(np.linalg.norm(end - start))
    axis = (end - start) / length_m
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    side = np.cross(helper, axis)
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(axis, side), axis], axis=1)
    matrix[:3, 3] = (start + end) / 2
    return Primitive(FRUSTUM, matrix, (radius_m, radius_m, length_m / 2), material)


def rectangle(
    material: Material, center_m: Vector, right: Vector, up: Vector, sides_m: tuple[float, float]
) -> Primitive:
    """A one-sided rectangle by its centre, two unit axes and full sides; faces right x up."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, up, np.cross(right, up)], axis=1)
    matrix[:3, 3] = center_m
    return Primitive(RECTANGLE, matrix, (sides_m[0] / 2, sides_m[1] / 2, 0.0), material)
