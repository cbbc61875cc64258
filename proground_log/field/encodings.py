"""The two encodings of a point: one-blob, smooth and global; hash grid, learnt and local.

Points are normalised to [0, 1]^3 by the map's bounds. On the CPU both run on numba kernels, on
CUDA on plain torch; the plain-torch functions are also the reference that the kernels are tested
against.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from proground_log.field import kernels

FEATURES_PER_LEVEL = 2
ONE_BLOB_BINS = 16


@dataclass(frozen=True)
class HashGridLayout:
    """Geometry of a multi-resolution hash grid (Instant-NGP, as Co-SLAM uses it).

    Args:
        levels: number of levels.
        log2_rows: a level has at most 2^log2_rows rows; finer levels are hashed into them.
        base_resolution: cells along an axis at the coarsest level.
        finest_resolution: cells along an axis at the finest level.
    """

    levels: int
    log2_rows: int
    base_resolution: int
    finest_resolution: float

    @cached_property
    def scales(self) -> np.ndarray:
        """Cells along [0, 1] less one, float32 [levels]."""
        ratio = max(self.finest_resolution / self.base_resolution, 1.0)
        growth = ratio ** (1 / max(self.levels - 1, 1))
        return (self.base_resolution * growth ** np.arange(self.levels) - 1).astype(np.float32)

    @cached_property
    def resolutions(self) -> np.ndarray:
        """Corners along an axis, uint32 [levels]."""
        return (np.ceil(self.scales) + 1).astype(np.uint32)

    @cached_property
    def masks(self) -> np.ndarray:
        """Rows of a hashed level less one, 0 for a dense level, uint32 [levels]."""
        rows = 2**self.log2_rows
        # One corner more than the resolution is reached by points on the upper faces.
        dense = (self.resolutions.astype(np.int64) + 1) ** 3 <= rows
        return np.where(dense, 0, rows - 1).astype(np.uint32)

    @cached_property
    def offsets(self) -> np.ndarray:
        """First row of each level, then the number of rows in all, int64 [levels + 1]."""
        corners = (self.resolutions.astype(np.int64) + 1) ** 3
        rows = np.where(self.masks == 0, corners, 2**self.log2_rows)
        return np.concatenate([[0], np.cumsum(rows)])

    @property
    def rows(self) -> int:
        """Rows of the whole table."""
        return int(self.offsets[-1])


def hash_grid_torch(points: Tensor, table: Tensor, layout: HashGridLayout) -> Tensor:
    """As `hash_grid`, in plain torch."""
    features = []
    for level in range(layout.levels):
        position = points * float(layout.scales[level]) + 0.5
        cell = position.floor()
        fraction = position - cell
        cell = cell.long()
        mixed = torch.zeros(len(points), FEATURES_PER_LEVEL, dtype=table.dtype, device=table.device)
        for corner in range(8):
            offset = [corner & 1, (corner >> 1) & 1, corner >> 2]
            step = torch.tensor(offset, device=points.device)
            x, y, z = (cell + step).unbind(-1)
            weight = torch.where(step.bool(), fraction, 1 - fraction).prod(dim=-1)
            if layout.masks[level] == 0:
                side = int(layout.resolutions[level]) + 1
                row = x + side * (y + side * z)
            else:
                hashed = x ^ (y * int(kernels.PRIME_Y)) ^ (z * int(kernels.PRIME_Z))
                row = hashed & int(layout.masks[level])
            row = row + int(layout.offsets[level])
            mixed = mixed + weight[:, None] * table[row]
        features.append(mixed)
    return torch.cat(features, dim=-1)


class _HashGridOnCpu(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, layout: HashGridLayout) -> Tensor:
        features = torch.empty(len(points), FEATURES_PER_LEVEL * layout.levels)
        kernels.hash_grid_forward(
            points.numpy(),
            table.detach().numpy(),
            layout.scales,
            layout.resolutions,
            layout.offsets,
            layout.masks,
            numba.get_num_threads(),
            features.numpy(),
        )
        ctx.save_for_backward(points, table)
        ctx.layout = layout
        return features

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor, None]:
        points, table = ctx.saved_tensors
        layout = ctx.layout
        table_gradient = torch.empty_like(table)
        kernels.hash_grid_backward(
            points.numpy(),
            gradient.contiguous().numpy(),
            layout.scales,
            layout.resolutions,
            layout.offsets,
            layout.masks,
            table_gradient.numpy(),
        )
        return None, table_gradient, None


def hash_grid(points: Tensor, table: Tensor, layout: HashGridLayout) -> Tensor:
    """Learnt features of points.

    Args:
        points: float32 [N, 3] in [0, 1], contiguous; they get no gradient.
        table: float32 [layout.rows, 2].
        layout: where each level's rows lie.

    Returns:
        float32 [N, 2 levels], trilinear in each level; differentiable in the table.
    """
    if points.is_cuda:
        return hash_grid_torch(points, table, layout)
    features: Tensor = _HashGridOnCpu.apply(points, table, layout)  # type: ignore[no-untyped-call]
    return features


def one_blob_torch(points: Tensor) -> Tensor:
    """As `one_blob`, in plain torch."""
    edges = torch.arange(ONE_BLOB_BINS + 1, device=points.device, dtype=points.dtype)
    position = points[..., None] * ONE_BLOB_BINS
    encoding = torch.zeros(*points.shape, ONE_BLOB_BINS, device=points.device, dtype=points.dtype)
    for turn in (-ONE_BLOB_BINS, 0, ONE_BLOB_BINS):
        u = (edges + turn - position).clamp(-1, 1)
        cdf = 15 / 16 * u * (1 - 2 / 3 * u**2 + 1 / 5 * u**4)
        encoding = encoding + cdf[..., 1:] - cdf[..., :-1]
    return encoding.flatten(-2)


def one_blob(points: Tensor) -> Tensor:
    """Encode each coordinate as the mass of a quartic bump in 16 bins, wrapping around.

    Args:
        points: float32 [N, 3] in [0, 1], contiguous; they get no gradient.

    Returns:
        float32 [N, 48], each axis' bins adding up to 1.
    """
    if points.is_cuda:
        return one_blob_torch(points)
    encoding = torch.empty(len(points), 3 * ONE_BLOB_BINS)
    kernels.one_blob_forward(points.numpy(), ONE_BLOB_BINS, encoding.numpy())
    return encoding
