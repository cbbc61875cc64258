"""Volume rendering of a signed distance field (paper, Eq. 4)."""

from __future__ import annotations

import torch
from torch import Tensor

SHARPNESS = 10.0
"""Slope of the sigmoids, in 1 / truncation: Co-SLAM's 1 / tr at its tr of 0.1."""


def sdf_weights(sdf: Tensor, inside: Tensor) -> Tensor:
    """Normalised weights of the samples along each ray.

    w = sigmoid(k s) sigmoid(-k s), for the samples up to one truncation behind the first change of
    sign, divided by their sum.

    Args:
        sdf: [R, S] in units of the truncation, samples in order of depth.
        inside: bool [R, S], samples that count: within the bounds and not behind the surface.

    Returns:
        [R, S]; a row adds up to 1, or to 0 where no sample counts.
    """
    weights = torch.sigmoid(SHARPNESS * sdf) * torch.sigmoid(-SHARPNESS * sdf) * inside
    return weights / weights.sum(dim=1, keepdim=True).clamp_min(1e-8)


def before_surface(sdf: Tensor, depth_m: Tensor, truncation_m: float) -> Tensor:
    """Samples up to one truncation behind the first change of sign from + to -, bool [R, S].

    Args:
        sdf: [R, S] in units of the truncation.
        depth_m: [R, S] depth of the samples in metres, ascending.
        truncation_m: in metres.
    """
    crosses = (sdf[:, :-1] > 0) & (sdf[:, 1:] <= 0)
    first = crosses.to(torch.uint8).argmax(dim=1, keepdim=True)
    end_m = torch.where(
        crosses.any(dim=1, keepdim=True),
        depth_m.gather(1, first) + truncation_m,
        depth_m.new_full((1, 1), torch.inf),
    )
    return depth_m < end_m


def composite(weights: Tensor, values: Tensor) -> Tensor:
    """Sum of the samples' values [R, S, C], weighted [R, S]: what the ray sees, [R, C]."""
    return torch.bmm(weights[:, None, :], values)[:, 0]
