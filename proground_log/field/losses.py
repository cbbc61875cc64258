"""The losses of colour and geometry (paper 4.3, after Co-SLAM).

Each is a mean over the samples or rays concerned. Published code averages the SDF and free-space
terms over all samples and rescales them by the share of each kind, so that their size depends on
the number of samples; here it does not, and the default weights make up for it.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


def weighted_mean(values: Tensor, weights: Tensor) -> Tensor:
    """Sum of values x weights over the sum of weights; 0 where all weights are 0.

    Summed along the samples first and over the rays last, so that the result does not depend on
    the number of threads (a sum over everything at once does).

    Args:
        values, weights: [R] or [R, S].
    """
    products = values * weights
    if values.dim() == 2:
        products, weights = products.sum(dim=1), weights.sum(dim=1)
    return products.sum() / weights.sum().clamp_min(1e-8)


def color_loss(rendered: Tensor, observed: Tensor, ray_weights: Tensor) -> Tensor:
    """Mean squared error of the colour [R, 3] in [0, 1]; rays weighted [R]."""
    return weighted_mean((rendered - observed).square().mean(dim=1), ray_weights)


def depth_loss(rendered_m: Tensor, observed_m: Tensor, ray_weights: Tensor) -> Tensor:
    """Mean squared error of the depth [R] in square metres; rays weighted [R]."""
    return weighted_mean((rendered_m - observed_m).square(), ray_weights)


def sdf_losses(
    sdf: Tensor,
    sample_depth_m: Tensor,
    observed_m: Tensor,
    inside: Tensor,
    ray_weights: Tensor,
    truncation_m: float,
) -> tuple[Tensor, Tensor]:
    """The SDF and the free-space loss.

    Within the truncation of the measured surface the SDF has to be the distance to it along the
    ray, (z + s tr - d)^2 in square metres; in front of that, (s - 1)^2.

    Args:
        sdf: [R, S] in units of the truncation.
        sample_depth_m: [R, S] depth of the samples.
        observed_m: [R] measured depth, > 0.
        inside: bool [R, S], samples within the bounds.
        ray_weights: [R].
        truncation_m: in metres.
    """
    distance_m = observed_m[:, None] - sample_depth_m
    weights = ray_weights[:, None] * inside
    near = weights * (distance_m.abs() <= truncation_m)
    free = weights * (distance_m > truncation_m)
    sdf_error = (sdf * truncation_m - distance_m).square()
    return weighted_mean(sdf_error, near), weighted_mean((sdf - 1).square(), free)


def smoothness_loss(lattice_features: Tensor) -> Tensor:
    """Mean squared forward difference of the hash features on a lattice, [P, P, P, C]."""
    f = lattice_features
    differences = [
        (f[1:] - f[:-1]).square(),
        (f[:, 1:] - f[:, :-1]).square(),
        (f[:, :, 1:] - f[:, :, :-1]).square(),
    ]
    # Rows first: a sum over everything at once depends on the number of threads.
    return torch.stack([d.flatten(1).mean(dim=1).mean() for d in differences]).sum()


def semantic_loss(
    rendered: Tensor, observed: Tensor, confidence: Tensor, *, squared: bool = False
) -> Tensor:
    """c_tau || f' - f ||_2 (Eq. 5), averaged over the rays with c_tau as their weight.

    Args:
        rendered, observed: [R, 512].
        confidence: [R], c_tau, or 1 where regions are not weighted.
        squared: take the squared norm, which colour and depth have; Eq. 5 prints the norm.
    """
    distance = (rendered - observed).square().sum(dim=1)
    if not squared:
        # A norm has no gradient where it is zero.
        distance = distance.add(1e-12).sqrt()
    return weighted_mean(distance, confidence)


def focal_loss(logits: Tensor, classes: Tensor, gamma: float = 2.0) -> Tensor:
    """-alpha_k (1 - p_k)^gamma log p_k (Eq. 6) with alpha_k the inverse frequency of the class.

    Args:
        logits: [R, K].
        classes: int64 [R], in 0..K-1.
        gamma: how far rays that are classified well count less.
    """
    counts = nn.functional.one_hot(classes, logits.shape[1]).sum(dim=0).to(logits.dtype)
    present = (counts > 0).sum()
    alpha = len(classes) / (present * counts.clamp_min(1.0))
    log_p = logits.log_softmax(dim=1).gather(1, classes[:, None])[:, 0]
    return weighted_mean((1 - log_p.exp()).pow(gamma) * -log_p, alpha[classes])


def uncertainty_loss(logits: Tensor, unsupervised: Tensor) -> Tensor:
    """Binary cross-entropy of "this ray has no supervision", u = 0; both kinds count alike.

    The paper names the head and not its loss.

    Args:
        logits: [R].
        unsupervised: bool [R].
    """
    terms = nn.functional.binary_cross_entropy_with_logits(
        logits, unsupervised.to(logits.dtype), reduction="none"
    )
    share = unsupervised.to(logits.dtype).mean()
    weights = torch.where(unsupervised, 1 - share, share)
    return weighted_mean(terms, weights.clamp_min(1e-3))
