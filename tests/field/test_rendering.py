"""Rendering weights and losses against loops over their definition, gradients included."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from proground_log.field.losses import (
    color_loss,
    depth_loss,
    sdf_losses,
    smoothness_loss,
    weighted_mean,
)
from proground_log.field.rendering import SHARPNESS, before_surface, composite, sdf_weights
from proground_log.field.sampling import sample_depths
from proground_log.streams import stream

TR_M = 0.1


def random(*shape: int) -> torch.Tensor:
    return torch.from_numpy(stream(0, "test rendering", *shape).standard_normal(shape))


def test_weights_are_bells_around_the_surface_and_add_up_to_one() -> None:
    sdf = random(5, 9) / 5
    inside = random(5, 9) > -0.5
    inside[3] = False
    weights = sdf_weights(sdf, inside)
    for ray in range(5):
        bells = [
            float(inside[ray, i]) / (1 + math.exp(-SHARPNESS * s)) / (1 + math.exp(SHARPNESS * s))
            for i, s in enumerate(sdf[ray].tolist())
        ]
        expected = np.array(bells) / max(sum(bells), 1e-8)
        np.testing.assert_allclose(weights[ray].numpy(), expected, rtol=1e-6)
    assert weights.sum(dim=1).tolist() == pytest.approx([1, 1, 1, 0, 1])


def test_weights_and_composite_have_the_gradient_of_finite_differences() -> None:
    sdf, values = (random(3, 6) / 5).requires_grad_(), random(3, 6, 2).requires_grad_()
    inside = torch.ones(3, 6, dtype=torch.bool)

    def render(s: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return composite(sdf_weights(s, inside), v)

    assert torch.autograd.gradcheck(render, (sdf, values))
    expected = (sdf_weights(sdf, inside)[..., None] * values).sum(dim=1)
    torch.testing.assert_close(render(sdf, values), expected)


def test_samples_count_up_to_one_truncation_behind_the_first_change_of_sign() -> None:
    depth_m = torch.tensor([[0.5, 1.0, 1.05, 1.12, 2.0]]).repeat(3, 1)
    sdf = torch.tensor(
        [[1.0, 0.2, -0.3, -1.0, 1.0], [1.0, 1.0, 1.0, 0.5, 0.1], [-1.0, 1.0, 1.0, 1.0, -1.0]]
    )
    counted = before_surface(sdf, depth_m, TR_M).tolist()
    assert counted[0] == [True, True, True, False, False]
    assert counted[1] == [True] * 5
    assert counted[2] == [True] * 4 + [False]


def test_color_and_depth_losses_are_weighted_means() -> None:
    rendered, observed = random(4, 3), random(4, 3) / 2
    weights = torch.tensor([1.0, 0.5, 0.0, 2.0], dtype=torch.float64)
    errors = [((rendered[i] - observed[i]) ** 2).mean().item() for i in range(4)]
    expected = (errors[0] + 0.5 * errors[1] + 2 * errors[3]) / 3.5
    assert color_loss(rendered, observed, weights).item() == pytest.approx(expected)
    z, d = random(4), random(4)
    errors = ((z - d) ** 2).tolist()
    expected = (errors[0] + 0.5 * errors[1] + 2 * errors[3]) / 3.5
    assert depth_loss(z, d, weights).item() == pytest.approx(expected)


def test_sdf_losses_follow_their_definition_sample_by_sample() -> None:
    sdf = (random(6, 8) / 2).requires_grad_()
    z_m = torch.linspace(0.2, 1.4, 8).double().repeat(6, 1)
    observed_m = torch.linspace(0.6, 1.2, 6).double()
    inside = random(6, 8) > -1
    weights = torch.tensor([1.0, 1, 1, 0.3, 0.3, 0.3], dtype=torch.float64)
    near = near_weight = free = free_weight = 0.0
    for ray in range(6):
        for i in range(8):
            s, z, d = sdf[ray, i].item(), z_m[ray, i].item(), observed_m[ray].item()
            w = weights[ray].item() * float(inside[ray, i])
            if abs(z - d) <= TR_M:
                near, near_weight = near + w * (z + s * TR_M - d) ** 2, near_weight + w
            elif z < d:
                free, free_weight = free + w * (s - 1) ** 2, free_weight + w
    sdf_term, free_term = sdf_losses(sdf, z_m, observed_m, inside, weights, TR_M)
    assert sdf_term.item() == pytest.approx(near / near_weight)
    assert free_term.item() == pytest.approx(free / free_weight)

    def both(s: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return sdf_losses(s, z_m, observed_m, inside, weights, TR_M)

    assert torch.autograd.gradcheck(both, sdf)


def test_losses_without_any_sample_are_zero_and_finite() -> None:
    nothing = torch.zeros(3, 4, dtype=torch.float64, requires_grad=True)
    loss = weighted_mean(nothing, torch.zeros(3, 4, dtype=torch.float64))
    (gradient,) = torch.autograd.grad(loss, nothing)
    assert loss.item() == 0
    assert gradient.isfinite().all()


def test_smoothness_is_the_mean_squared_forward_difference() -> None:
    features = random(4, 4, 4, 2).requires_grad_()
    f = features.detach().numpy()
    expected = sum(np.square(np.diff(f, axis=axis)).mean() for axis in range(3))
    assert smoothness_loss(features).item() == pytest.approx(expected)
    assert torch.autograd.gradcheck(smoothness_loss, features)
    assert smoothness_loss(torch.ones(4, 4, 4, 2)).item() == 0


def test_a_loss_does_not_depend_on_the_number_of_threads() -> None:
    values, weights = random(1024, 43).float(), random(1024, 43).float().abs()
    before = torch.get_num_threads()
    try:
        results = set()
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            results.add(weighted_mean(values, weights).item())
        assert len(results) == 1
    finally:
        torch.set_num_threads(before)


@given(
    depth_m=st.lists(st.floats(0.25, 8, width=32), min_size=1, max_size=5),
    uniform=st.integers(2, 20),
    near_surface=st.integers(2, 12),
)
def test_samples_ascend_between_near_and_the_end_of_the_range(
    depth_m: list[float], uniform: int, near_surface: int
) -> None:
    depths_m = np.array(depth_m, np.float32)
    count = uniform + near_surface
    jitter = stream(0, "jitter").random((len(depths_m), count), dtype=np.float32)
    z_m = sample_depths(
        depths_m,
        uniform=uniform,
        near_surface=near_surface,
        near_m=0.05,
        range_m=0.1,
        jitter=jitter,
    )
    assert z_m.shape == (len(depths_m), count)
    assert (np.diff(z_m, axis=1) >= -1e-6).all()
    assert (z_m >= np.float32(0.05) - 1e-6).all()
    assert (z_m <= depths_m[:, None] + 0.1 + 1e-5).all()
    # A sample moves half-way to its neighbours at most, so most stay within the surface's range.
    close = (np.abs(z_m - depths_m[:, None]) <= 0.1 + 1e-5).sum(axis=1)
    assert (close >= near_surface - 1).all()
