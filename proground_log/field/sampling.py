"""Where along a ray the field is asked."""

from __future__ import annotations

import numpy as np


def sample_depths(
    depth_m: np.ndarray,
    *,
    uniform: int,
    near_surface: int,
    near_m: float,
    range_m: float,
    jitter: np.ndarray,
) -> np.ndarray:
    """Depths of the samples along rays whose surface is known.

    `uniform` samples fill the ray from `near_m` to the end of the surface's range, `near_surface`
    ones the range itself; the sorted samples are then moved at random between the mid-points to
    their neighbours. Co-SLAM's uniform samples go on to the far plane; behind the truncation no
    loss looks at them, so here they all stay in front.

    Args:
        depth_m: float32 [R], measured depth, > 0.
        uniform, near_surface: number of samples.
        near_m: where the uniform samples begin.
        range_m: the surface's range is depth +- range_m.
        jitter: float32 [R, uniform + near_surface] in [0, 1).

    Returns:
        float32 [R, uniform + near_surface], ascending.
    """
    end_m = depth_m[:, None] + np.float32(range_m)
    spread = np.linspace(0, 1, uniform, dtype=np.float32)
    along_m = near_m + (end_m - np.float32(near_m)) * spread
    offsets_m = np.linspace(-range_m, range_m, near_surface, dtype=np.float32)
    at_surface_m = np.maximum(depth_m[:, None] + offsets_m, np.float32(near_m))
    sorted_m = np.sort(np.concatenate([along_m, at_surface_m], axis=1), axis=1)
    middle_m = 0.5 * (sorted_m[:, 1:] + sorted_m[:, :-1])
    lower_m = np.concatenate([sorted_m[:, :1], middle_m], axis=1)
    upper_m = np.concatenate([middle_m, sorted_m[:, -1:]], axis=1)
    return lower_m + (upper_m - lower_m) * jitter
