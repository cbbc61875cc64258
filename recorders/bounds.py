"""The box that a recording's depth fills."""

from __future__ import annotations

import numpy as np

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame

PIXEL_STRIDE = 8
BINS_PER_M = 100
TAIL = 0.001
"""Less would let a sensor's stray points widen the box; more cuts off walls that only a few of
many frames saw (0.5 % did so in an 18 m long flat)."""
MARGIN_BINS = 30
STEP_BINS = 10
FARTHEST_M = 10_000.0
"""A point beyond this is a broken pose or depth; it would also make the histograms large."""


class Histogram:
    """Counts of centimetres along one axis, over a range that grows as it must."""

    def __init__(self) -> None:
        self._first_bin = 0
        self._counts = np.zeros(0, dtype=np.int64)

    def add(self, values_m: np.ndarray) -> None:
        """Count values [N] in metres."""
        bins = np.floor(values_m * BINS_PER_M).astype(np.int64)
        first = int(bins.min())
        counts = np.bincount(bins - first)
        self._reach(first, first + len(counts))
        start = first - self._first_bin
        self._counts[start : start + len(counts)] += counts

    def inner_bins(self) -> tuple[int, int]:
        """Lower edge of the bin of the lower percentile, upper edge of that of the upper one."""
        cumulative = np.cumsum(self._counts)
        total = int(cumulative[-1])
        lower = int(np.searchsorted(cumulative, TAIL * total, side="right"))
        upper = int(np.searchsorted(cumulative, (1 - TAIL) * total, side="left"))
        return self._first_bin + lower, self._first_bin + upper + 1

    def _reach(self, first: int, stop: int) -> None:
        """Make the range hold the bins from `first` up to, not including, `stop`."""
        if not len(self._counts):
            self._first_bin = first
        before = max(0, self._first_bin - first)
        after = max(0, stop - (self._first_bin + len(self._counts)))
        if before or after:
            self._counts = np.pad(self._counts, (before, after))
            self._first_bin -= before


class BoundsEstimator:
    """Percentiles of back-projected depth along the world's axes, in constant memory."""

    def __init__(self) -> None:
        self._axes = (Histogram(), Histogram(), Histogram())
        self._camera: Camera | None = None
        self._directions = np.zeros((0, 0, 3))
        self._is_empty = True

    def add(self, frame: SensorFrame, camera: Camera) -> None:
        """Count every eighth pixel, in each direction, of a frame's depth.

        Args:
            frame: its depth is [H, W]; values that are not finite and above 0 are left out, and
                points farther than 10 km from the origin.
            camera: the depth camera, of that size.

        Raises:
            ProgroundError: all points are that far away, as with a broken pose.
        """
        half = PIXEL_STRIDE // 2
        chosen = (slice(half, None, PIXEL_STRIDE), slice(half, None, PIXEL_STRIDE))
        if camera != self._camera:
            self._camera, self._directions = camera, camera.directions[chosen].astype(np.float64)
        depth = frame.depth[chosen]
        valid = np.isfinite(depth) & (depth > 0)
        if not valid.any():
            return
        scale_m = 1e-3 if depth.dtype == np.uint16 else 1.0
        depth_m = depth[valid] * scale_m
        x, y, z = (self._directions[valid] * depth_m[:, None]).T
        # Written out, not as a matrix product: BLAS may add in another order elsewhere.
        points_m = np.stack(
            [a * x + b * y + c * z + d for a, b, c, d in frame.world_from_camera[:3]]
        )
        # Also false where a number is none.
        is_near = (np.abs(points_m) <= FARTHEST_M).all(axis=0)
        if not is_near.any():
            raise ProgroundError(
                f"all its points are over {FARTHEST_M / 1000:.0f} km from the origin",
                where=f"frame {frame.index}",
                todo="mend its depth or its pose (unit metres?), or leave the frame out",
            )
        for histogram, values_m in zip(self._axes, points_m[:, is_near], strict=True):
            histogram.add(values_m)
        self._is_empty = False

    def bounds(self) -> Bounds:
        """The 0.1 and 99.9 percentiles, 0.3 m wider on each side, rounded outward to 0.1 m.

        Raises:
            ProgroundError: no frame had any valid depth.
        """
        if self._is_empty:
            raise ProgroundError(
                "no frame has any valid depth",
                where="bounds",
                todo="check the depth images and their scale",
            )
        (x0, x1), (y0, y1), (z0, z1) = (_widened(*axis.inner_bins()) for axis in self._axes)
        return Bounds((x0, y0, z0), (x1, y1, z1))


def _widened(lower_bin: int, upper_bin: int) -> tuple[float, float]:
    """Metres of a range of bins with the margin, outward to whole steps: integers until last."""
    lower_step = (lower_bin - MARGIN_BINS) // STEP_BINS
    upper_step = -((-upper_bin - MARGIN_BINS) // STEP_BINS)
    return lower_step * STEP_BINS / BINS_PER_M, upper_step * STEP_BINS / BINS_PER_M
