"""How well depth, poses and intrinsics of two frames agree, on a coarse grid of samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from numba import njit

from proground_log.camera import Camera
from proground_log.frame import SensorFrame
from proground_log.log.checking.suspicions import AS_GIVEN, Suspicion

COLUMNS = 80
"""About how many samples of depth are kept along a row."""
POINT_STRIDE = 3
"""Of the samples kept, every third along each axis is carried into the other frame."""
TOLERANCE = 0.05
"""Share of the depth by which two frames may differ and still agree. No length: in a wrong unit
every depth would lie within a few centimetres, or none."""
LARGEST_STEP = 1.2
"""Ratio of neighbouring samples beyond which they lie on two surfaces; a floor seen at 15 degrees
stays below."""


@dataclass(frozen=True, eq=False)
class View:
    """What is kept of a frame: samples of its depth on a grid, without lens distortion.

    Args:
        depth_m: float32 [H, W], 0 where nothing was measured.
        intrinsics: fx, fy, cx, cy in steps of the grid, float64 [4].
        first: where the first sample is on these axes, float64, both ways.
        world_from_camera: float64 [4, 4].
    """

    depth_m: np.ndarray
    intrinsics: np.ndarray
    first: float
    world_from_camera: np.ndarray

    @cached_property
    def depths_carried_m(self) -> np.ndarray:
        """The depths above 0 that are carried into other frames, float32 [N]."""
        chosen = slice(POINT_STRIDE // 2, None, POINT_STRIDE)
        samples = self.depth_m[chosen, chosen]
        return samples[samples > 0]


class Grid:
    """Which pixels of a depth camera are kept."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        stride = max(1, round(camera.width / COLUMNS))
        start = stride // 2 + 0.5
        self.first = start / stride
        self.intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy]) / stride
        u, v = np.meshgrid(
            np.arange(start, camera.width, stride), np.arange(start, camera.height, stride)
        )
        if not camera.is_ideal:
            x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
            rays = np.stack([x, y, np.ones_like(x)], axis=-1)
            u, v = np.moveaxis(camera.project(rays.reshape(-1, 3)).reshape(*u.shape, 2), -1, 0)
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        self._rows, self._columns = (np.where(inside, x, 0).astype(np.int64) for x in (v, u))
        self._outside = ~inside

    def view(self, frame: SensorFrame) -> View:
        """A frame's samples; its depth has the camera's size."""
        depth = frame.depth[self._rows, self._columns]
        depth_m = depth * np.float32(1e-3) if depth.dtype == np.uint16 else depth
        depth_m[self._outside | ~(np.isfinite(depth_m) & (depth_m > 0))] = 0
        return View(depth_m, self.intrinsics, self.first, frame.world_from_camera)


Pair = tuple[View, View]


@dataclass(frozen=True, eq=False)
class Agreement:
    """How well P pairs of frames agree, under a suspicion or as they are.

    Args:
        samples: points of each pair's first frame, int64 [P], all above 0.
        compared: how many of them met depth in the second one, int64 [P].
        errors: (carried - measured) / measured of these, one pair's after another's, float64.
    """

    samples: np.ndarray
    compared: np.ndarray
    errors: np.ndarray

    @cached_property
    def scores(self) -> np.ndarray:
        """Of each pair 0 to 1: the share of points that agree, the better the more; [P].

        Points that come to lie outside the other image count as much as those that disagree:
        else a mistake that throws nearly all of them out would pass.
        """
        pair = np.repeat(np.arange(len(self.samples)), self.compared)
        closeness = np.maximum(0.0, 1 - np.abs(self.errors) / TOLERANCE)
        return np.bincount(pair, closeness, minlength=len(self.samples)) / self.samples

    @cached_property
    def score(self) -> float:
        """Mean of the scores."""
        return float(self.scores.mean()) if len(self.scores) else 0.0

    @property
    def share_compared(self) -> float:
        """Share of points that met depth in the other frame."""
        return len(self.errors) / max(1, int(self.samples.sum()))

    @property
    def share_agreeing(self) -> float:
        """Share of those that differ by less than `TOLERANCE`; NaN where there are none."""
        agrees = np.abs(self.errors) < TOLERANCE
        return float(agrees.mean()) if len(agrees) else float("nan")

    @property
    def median_error(self) -> float:
        """Median difference as a share of the depth; NaN likewise."""
        return float(np.median(np.abs(self.errors))) if len(self.errors) else float("nan")


def agreement(pairs: Sequence[Pair], suspicion: Suspicion = AS_GIVEN) -> Agreement:
    """Carry each pair's first frame into its second, with a suspected mistake undone."""
    if not pairs:
        return Agreement(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    views = [view for pair in pairs for view in pair]
    poses = suspicion.poses(np.stack([view.world_from_camera for view in views]))
    intrinsics = suspicion.intrinsics(np.stack([view.intrinsics for view in views]))
    errors = [
        _errors(
            *(first.depth_m, second.depth_m, first.first, second.first),
            *(intrinsics[i], intrinsics[i + 1], poses[i], poses[i + 1], suspicion.along_ray),
        )
        for i, (first, second) in zip(range(0, len(views), 2), pairs, strict=True)
    ]
    samples = np.array([len(first.depths_carried_m) for first, _ in pairs], dtype=np.int64)
    compared = np.array([len(each) for each in errors], dtype=np.int64)
    return Agreement(samples, compared, np.concatenate(errors))


Function = Callable[..., np.ndarray]


def _compiled(function: Function) -> Function:
    """Compile without fast-math, so that every operation rounds as IEEE 754 says."""
    return cast(Function, njit(cache=True, error_model="numpy")(function))


@_compiled
def _errors(
    first_m: Any,
    second_m: Any,
    first: float,
    to_first: float,
    intrinsics: Any,
    to_intrinsics: Any,
    pose: Any,
    to_pose: Any,
    along_ray: bool,
) -> Any:
    """(carried - measured) / measured of each point of the first view that meets the second [N].

    What was measured is interpolated in inverse depth, in which planes are straight, and only
    between four samples of one surface.
    """
    # second_from_first, of rotations that may mirror: their transpose is their inverse still.
    a, b = pose, to_pose
    turn, shift_m = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        for j in range(3):
            turn[i, j] = b[0, i] * a[0, j] + b[1, i] * a[1, j] + b[2, i] * a[2, j]
        for j in range(3):
            shift_m[i] += b[j, i] * (a[j, 3] - b[j, 3])
    fx, fy, cx, cy = intrinsics
    to_fx, to_fy, to_cx, to_cy = to_intrinsics
    rows, columns = second_m.shape
    errors = np.empty(first_m.size)
    count = 0
    for row in range(POINT_STRIDE // 2, first_m.shape[0], POINT_STRIDE):
        for column in range(POINT_STRIDE // 2, first_m.shape[1], POINT_STRIDE):
            depth_m = float(first_m[row, column])
            if depth_m <= 0:
                continue
            x, y = (column + first - cx) / fx, (row + first - cy) / fy
            if along_ray:
                depth_m /= np.sqrt(1 + x * x + y * y)
            carried_x_m = (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2]) * depth_m + shift_m[0]
            carried_y_m = (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2]) * depth_m + shift_m[1]
            carried_m = (turn[2, 0] * x + turn[2, 1] * y + turn[2, 2]) * depth_m + shift_m[2]
            if carried_m <= 0:
                continue
            u = carried_x_m / carried_m * to_fx + to_cx - to_first
            v = carried_y_m / carried_m * to_fy + to_cy - to_first
            # Also false for numbers that are not finite.
            if not (u >= 0 and v >= 0 and u < columns - 1 and v < rows - 1):
                continue
            i, j = int(v), int(u)
            m00, m01 = second_m[i, j], second_m[i, j + 1]
            m10, m11 = second_m[i + 1, j], second_m[i + 1, j + 1]
            nearest_m = min(m00, m01, m10, m11)
            if nearest_m <= 0 or max(m00, m01, m10, m11) > LARGEST_STEP * nearest_m:
                continue
            down, right = v - i, u - j
            inverse = (1 - down) * ((1 - right) / m00 + right / m01) + down * (
                (1 - right) / m10 + right / m11
            )
            if along_ray:
                x, y = (u + to_first - to_cx) / to_fx, (v + to_first - to_cy) / to_fy
                inverse *= np.sqrt(1 + x * x + y * y)
            errors[count] = carried_m * inverse - 1
            count += 1
    return errors[:count]
