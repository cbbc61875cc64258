"""Where the sensor saw a surface: the part of the map that is more than a guess."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt

from proground_log.bounds import Bounds
from proground_log.camera import transform
from proground_log.frame import Frame

VOXEL_M = 0.05
BLOCK = 2
BLOCK_M = BLOCK * VOXEL_M
"""Distances are kept for blocks of 2 x 2 x 2 voxels, an eighth of the work."""
PIXEL_STRIDE = 4
"""Every so many pixels each way are looked at: at 5 m they are 4 cm apart, within a voxel."""


class ObservedSurface:
    """Voxels of the bounds in which a depth was measured.

    Args:
        bounds: the box.
    """

    def __init__(self, bounds: Bounds) -> None:
        self.bounds = bounds
        shape = np.ceil(bounds.size_m / VOXEL_M).astype(int)
        self.voxels = np.zeros(shape, dtype=bool)

    def add(self, frame: Frame) -> None:
        """Mark where the frame's depth lies."""
        sparse = np.s_[PIXEL_STRIDE // 2 :: PIXEL_STRIDE, PIXEL_STRIDE // 2 :: PIXEL_STRIDE]
        depth_m = frame.depth_m[sparse]
        points_m = (frame.camera.directions[sparse] * depth_m[..., None])[depth_m > 0]
        points_m = transform(frame.world_from_camera, points_m)
        cells = self._cells(points_m[self.bounds.contains(points_m)])
        self.voxels[tuple(cells.T)] = True

    def near_lattice(self, axes_m: Sequence[np.ndarray]) -> np.ndarray:
        """Which points of a lattice lie in a marked voxel or within a spacing of one.

        Args:
            axes_m: the lattice's coordinates along x, y and z.

        Returns:
            bool [len(x), len(y), len(z)].
        """
        spacing_m = max((float(np.diff(axis_m).max(initial=0)) for axis_m in axes_m), default=0)
        reach = max(1, int(np.ceil(spacing_m / VOXEL_M - 1e-6)))
        grown = binary_dilation(self.voxels, np.ones((3, 3, 3), bool), iterations=reach)
        lower_m, most = self.bounds.lower_m, np.array(self.voxels.shape) - 1
        cells = [
            np.floor((axis_m - lower_m[i]) / VOXEL_M).astype(np.int64).clip(0, most[i])
            for i, axis_m in enumerate(axes_m)
        ]
        return np.asarray(grown[np.ix_(*cells)])

    def distance_m(self) -> np.ndarray:
        """How far any point of a block of voxels is at least from a marked one, in metres.

        Returns:
            float32 [X / 2, Y / 2, Z / 2], for blocks of BLOCK_M on a side.
        """
        padded = np.pad(self.voxels, [(0, -side % BLOCK) for side in self.voxels.shape])
        x, y, z = (side // BLOCK for side in padded.shape)
        split = padded.reshape(x, BLOCK, y, BLOCK, z, BLOCK)
        blocks: np.ndarray = np.any(split, axis=(1, 3, 5))
        if not blocks.any():
            return np.zeros(blocks.shape, np.float32)
        # Two points of two blocks are nearer than the centres by a diagonal at most.
        distance = np.maximum(distance_transform_edt(~blocks) - np.sqrt(3.0), 0.0) * BLOCK_M
        return distance.astype(np.float32)

    def _cells(self, points_m: np.ndarray) -> np.ndarray:
        cells = np.floor((points_m - self.bounds.lower_m) / VOXEL_M).astype(np.int64)
        return cells.clip(0, np.array(self.voxels.shape) - 1)
