"""Upright boxes around things: turned about the vertical only, as furniture is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

EXTENT_PERCENTILES = (2, 98)
"""A box leaves out so much on either side: a few stray vertices would stretch it."""
LEAST_EXTENT_M = 1e-3
"""Of a box: what is flat has a volume still, so that shares of it are numbers."""


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box that stands upright.

    Args:
        centre_m: float64 [3], world axes.
        extent_m: float64 [3], its length, width and height; length >= width.
        axes: float64 [3, 3], a row for the direction of each in the world; the last one is up, and
            they are right-handed.
        yaw_rad: from the x axis of `upright_from_world` to its length, counter-clockwise seen from
            above, in (-pi / 2, pi / 2].
    """

    centre_m: np.ndarray
    extent_m: np.ndarray
    axes: np.ndarray
    yaw_rad: float

    @property
    def volume_m3(self) -> float:
        return float(self.extent_m.prod())

    @property
    def bottom_m(self) -> float:
        """Height of its underside, along up from the world's origin."""
        return float(self.centre_m @ self.axes[2] - self.extent_m[2] / 2)

    @property
    def top_m(self) -> float:
        """Height of its upper side."""
        return self.bottom_m + float(self.extent_m[2])

    def contains(self, points_m: np.ndarray) -> np.ndarray:
        """Which points [N, 3] lie inside or on it, bool [N]."""
        along_m = (points_m - self.centre_m) @ self.axes.T
        return np.asarray((np.abs(along_m) <= self.extent_m / 2).all(axis=1))

    @cached_property
    def corners_m(self) -> np.ndarray:
        """The corners, float64 [8, 3], world axes."""
        signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        return self.centre_m + signs * self.extent_m @ self.axes


def upright_from_world(up: np.ndarray) -> np.ndarray:
    """The shortest rotation, float64 [3, 3], that takes the direction up [3] to z."""
    if np.array_equal(up, (0, 0, 1)):
        return np.eye(3)  # Exactly: a world that stands on z keeps its numbers.
    rotation, _ = Rotation.align_vectors(np.array([[0.0, 0.0, 1.0]]), np.asarray(up)[None])
    return np.asarray(rotation.as_matrix())


def box_around(points_m: np.ndarray, up: np.ndarray) -> OrientedBox:
    """The upright box of some points.

    Its yaw is that of the smallest rectangle around their plan; along its axes it reaches from
    their 2nd to their 98th percentile.

    Args:
        points_m: float [N, 3], N >= 1, world axes.
        up: [3], of length 1.
    """
    upright = upright_from_world(up)
    points = points_m.astype(np.float64) @ upright.T
    # About their middle: cv2 computes in float32.
    plan = (points[:, :2] - points[:, :2].mean(axis=0)).astype(np.float32)
    yaw_rad = np.radians(cv2.minAreaRect(plan)[2])
    turned = points @ _turn(yaw_rad).T
    lower, upper = np.percentile(turned, EXTENT_PERCENTILES, axis=0)
    centre, size = (lower + upper) / 2 @ _turn(yaw_rad), upper - lower
    if size[1] > size[0]:
        yaw_rad, size = yaw_rad + np.pi / 2, size[[1, 0, 2]]
    # A box that is turned by half a turn is the same box.
    yaw_rad = np.pi / 2 - (np.pi / 2 - yaw_rad) % np.pi
    return OrientedBox(
        centre_m=centre @ upright,
        extent_m=np.maximum(size, LEAST_EXTENT_M),
        axes=_turn(yaw_rad) @ upright,
        yaw_rad=float(yaw_rad),
    )


def shared_volume_m3(first: OrientedBox, second: OrientedBox) -> float:
    """Volume of what two boxes with one up have in common."""
    height_m = min(first.top_m, second.top_m) - max(first.bottom_m, second.bottom_m)
    return max(height_m, 0.0) * shared_plan_m2(first, second)


def shared_plan_m2(first: OrientedBox, second: OrientedBox) -> float:
    """Area of what the plans of two boxes with one up have in common."""
    kind, corners = cv2.rotatedRectangleIntersection(*_plans(first, second))
    if kind == cv2.INTERSECT_NONE or corners is None:
        return 0.0
    return float(cv2.contourArea(cv2.convexHull(corners)))


def gap_m(first: OrientedBox, second: OrientedBox) -> float:
    """Distance between two boxes with one up, 0 where they overlap."""
    level_m = max(second.bottom_m - first.top_m, first.bottom_m - second.top_m, 0.0)
    plans = _plans(first, second)
    if cv2.rotatedRectangleIntersection(*plans)[0] != cv2.INTERSECT_NONE:
        return level_m
    a, b = (cv2.boxPoints(plan) for plan in plans)
    # Of convex shapes that are apart, one of the nearest points is a corner.
    inward_m = [cv2.pointPolygonTest(b, corner, True) for corner in a.tolist()]
    inward_m += [cv2.pointPolygonTest(a, corner, True) for corner in b.tolist()]
    return float(np.hypot(-max(inward_m), level_m))


_Plan = tuple[tuple[float, float], tuple[float, float], float]
"""A rectangle as cv2 has it: centre, size, turn in degrees."""


def _plans(first: OrientedBox, second: OrientedBox) -> tuple[_Plan, _Plan]:
    """Both boxes from above, in the axes of the first and about its centre."""
    x, y = first.axes[:2] @ (second.centre_m - first.centre_m)
    turn_deg = np.degrees(np.arctan2(*(first.axes[[1, 0]] @ second.axes[0])))
    sizes = [(float(box.extent_m[0]), float(box.extent_m[1])) for box in (first, second)]
    return ((0.0, 0.0), sizes[0], 0.0), ((float(x), float(y)), sizes[1], float(turn_deg))


def _turn(yaw_rad: float) -> np.ndarray:
    """The rotation that takes coordinates to axes turned by a yaw."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
