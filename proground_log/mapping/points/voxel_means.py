"""Means of what was measured in each voxel of a box: memory for maps that remember where."""

from __future__ import annotations

import numpy as np

from proground_log.bounds import Bounds


class VoxelMeans:
    """Sums of rows by the voxel they fall into, kept by rising voxel number.

    Rows are added up in an order of their own: the result depends on nothing but the rows.

    Args:
        bounds: the box; points outside are left out.
        voxel_m: side of a voxel.
        columns: numbers in a row.

    Attributes:
        keys: int64 [V], numbers of the voxels that have a row, rising.
        sums: float64 [V, columns].
        counts: float64 [V], sums of the rows' weights.
    """

    def __init__(self, bounds: Bounds, voxel_m: float, columns: int) -> None:
        self._lower_m, self._voxel_m = np.array(bounds.lower_m), voxel_m
        self._shape = np.maximum(np.ceil(bounds.size_m / voxel_m).astype(np.int64), 1)
        self.keys = np.zeros(0, np.int64)
        self.sums = np.zeros((0, columns))
        self.counts = np.zeros(0)

    def __len__(self) -> int:
        return len(self.keys)

    def keys_of(self, points_m: np.ndarray) -> np.ndarray:
        """The voxel that each point [N, 3] falls into, int64 [N]; -1 outside the box."""
        cells = np.floor((points_m - self._lower_m) / self._voxel_m).astype(np.int64)
        inside = ((cells >= 0) & (cells < self._shape)).all(axis=1)
        x, y, z = cells.T
        return np.where(inside, (x * self._shape[1] + y) * self._shape[2] + z, -1)

    def add(
        self, points_m: np.ndarray, rows: np.ndarray, weights: np.ndarray | None = None
    ) -> None:
        """Add rows [N, columns] at points [N, 3], with weights [N], 1 each by default."""
        keys = self.keys_of(points_m)
        chosen = np.flatnonzero(keys >= 0)
        order = chosen[np.argsort(keys[chosen], kind="stable")]
        if not len(order):
            return
        weight = np.ones(len(keys)) if weights is None else weights.astype(np.float64)
        new_keys, starts = np.unique(keys[order], return_index=True)
        weighed = rows[order].astype(np.float64) * weight[order, None]
        new_sums = np.add.reduceat(weighed, starts, axis=0)
        new_counts = np.add.reduceat(weight[order], starts)
        keys = np.union1d(self.keys, new_keys)
        sums, counts = np.zeros((len(keys), self.sums.shape[1])), np.zeros(len(keys))
        for some, part, count in (
            (self.keys, self.sums, self.counts),
            (new_keys, new_sums, new_counts),
        ):
            at = np.searchsorted(keys, some)
            sums[at] += part
            counts[at] += count
        self.keys, self.sums, self.counts = keys, sums, counts

    def means(self) -> np.ndarray:
        """The mean of each voxel's rows, float32 [V, columns]."""
        return (self.sums / np.maximum(self.counts, 1e-12)[:, None]).astype(np.float32)

    def state(self) -> dict[str, np.ndarray]:
        """All that is held, by name."""
        return {"keys": self.keys, "sums": self.sums, "counts": self.counts}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned."""
        self.keys, self.sums, self.counts = state["keys"], state["sums"], state["counts"]
