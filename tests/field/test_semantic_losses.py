"""The losses of meaning against their formulas, written out ray by ray, and their gradients."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.field.losses import focal_loss, semantic_loss, uncertainty_loss
from proground_log.streams import stream


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(stream(seed, "test losses", *shape).standard_normal(shape))


def probabilities(logits: torch.Tensor) -> list[list[float]]:
    exponentials = [[math.exp(value) for value in row] for row in logits.tolist()]
    return [[value / sum(row) for value in row] for row in exponentials]


# Eq. 5.


def test_semantic_loss_is_the_distance_weighted_by_relevance() -> None:
    rendered, observed = random(6, 5), random(6, 5, seed=1)
    confidence = torch.tensor([0.9, 0.4, 1.0, 0.0, 0.7, 0.5], dtype=torch.float64)
    total = 0.0
    for ray in range(6):
        pairs = zip(rendered[ray].tolist(), observed[ray].tolist(), strict=True)
        total += confidence[ray].item() * math.sqrt(sum((a - b) ** 2 for a, b in pairs))
    expected = total / confidence.sum().item()
    assert semantic_loss(rendered, observed, confidence).item() == pytest.approx(expected)


def test_semantic_loss_has_the_gradient_of_its_formula() -> None:
    rendered, observed = random(6, 5).requires_grad_(), random(6, 5, seed=1)
    confidence = random(6, seed=2).abs()
    (ours,) = torch.autograd.grad(semantic_loss(rendered, observed, confidence), rendered)
    # d ||v|| / dv is the unit vector along v.
    unit = (rendered - observed).detach()
    unit /= unit.norm(dim=1, keepdim=True)
    expected = confidence[:, None] / confidence.sum() * unit
    torch.testing.assert_close(ours, expected)
    assert torch.autograd.gradcheck(lambda r: semantic_loss(r, observed, confidence), rendered)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_embedding_that_is_met_exactly_has_a_finite_gradient(dtype: torch.dtype) -> None:
    observed = random(4, 512).to(dtype)
    rendered = observed.clone()
    rendered[3, 0] += 1
    rendered.requires_grad_()
    loss = semantic_loss(rendered, observed, torch.ones(4, dtype=dtype))
    (gradient,) = torch.autograd.grad(loss, rendered)
    assert loss.item() == pytest.approx(0.25, abs=1e-5)
    assert gradient[:3].abs().max() == 0
    assert gradient[3, 0].item() == pytest.approx(0.25)
    nothing = semantic_loss(rendered, observed, torch.zeros(4, dtype=dtype))
    assert nothing.item() == 0


# Eq. 6.


def focal_by_hand(logits: torch.Tensor, classes: list[int], gamma: float) -> float:
    """Each class' mean of Eq. 6 without alpha, averaged over the classes that occur."""
    of_class: dict[int, list[float]] = {}
    for row, k in zip(probabilities(logits), classes, strict=True):
        of_class.setdefault(k, []).append(-((1 - row[k]) ** gamma) * math.log(row[k]))
    return sum(sum(terms) / len(terms) for terms in of_class.values()) / len(of_class)


@settings(max_examples=40, deadline=None)
@given(
    classes=st.lists(st.integers(0, 3), min_size=1, max_size=12),
    gamma=st.sampled_from([0.0, 1.0, 2.0, 3.5]),
)
def test_focal_loss_follows_eq_6(classes: list[int], gamma: float) -> None:
    logits = 2 * random(len(classes), 4)
    ours = focal_loss(logits, torch.tensor(classes), gamma)
    assert ours.item() == pytest.approx(focal_by_hand(logits, classes, gamma), rel=1e-6)


def test_focal_loss_has_the_gradient_of_finite_differences() -> None:
    logits = (2 * random(9, 4)).requires_grad_()
    classes = torch.tensor([0, 3, 3, 3, 1, 3, 0, 3, 3])
    assert torch.autograd.gradcheck(lambda x: focal_loss(x, classes), logits)


def test_focal_loss_of_a_class_does_not_depend_on_how_often_it_occurs() -> None:
    logits = random(3, 4)
    once = focal_loss(logits, torch.tensor([0, 2, 3]))
    rows = [0, 1, *[2] * 50]
    often = focal_loss(logits[rows], torch.tensor([0, 2, *[3] * 50]))
    assert often.item() == pytest.approx(once.item())


def test_focal_loss_looks_at_what_is_hard_and_survives_what_is_certain() -> None:
    logits = torch.tensor([[4.0, 0, 0, 0], [0.0, 0.5, 0, 0]], requires_grad=True)
    gradients = {}
    for gamma in (0.0, 2.0):
        loss = focal_loss(logits, torch.tensor([0, 0]), gamma)
        (gradient,) = torch.autograd.grad(loss, logits)
        gradients[gamma] = (gradient[1].norm() / gradient[0].norm()).item()
    assert gradients[2.0] > 50 * gradients[0.0]

    certain = torch.tensor([[200.0, 0, 0, 0], [-200.0, 0, 0, 200]], requires_grad=True)
    loss = focal_loss(certain, torch.tensor([0, 0]))
    (gradient,) = torch.autograd.grad(loss, certain)
    assert loss.item() == pytest.approx(200)
    assert gradient.isfinite().all()


# Uncertainty.


@settings(max_examples=40, deadline=None)
@given(st.lists(st.booleans(), min_size=1, max_size=12))
def test_uncertainty_loss_is_a_cross_entropy_in_which_both_kinds_count_alike(
    unsupervised: list[bool],
) -> None:
    logits = 2 * random(len(unsupervised))
    of_kind: dict[bool, list[float]] = {}
    for value, u in zip(logits.tolist(), unsupervised, strict=True):
        p = 1 / (1 + math.exp(-value))
        of_kind.setdefault(u, []).append(-math.log(p if u else 1 - p))
    expected = sum(sum(terms) / len(terms) for terms in of_kind.values()) / len(of_kind)
    ours = uncertainty_loss(logits, torch.tensor(unsupervised))
    assert ours.item() == pytest.approx(expected, rel=1e-6)


def test_uncertainty_loss_has_the_gradient_of_its_formula() -> None:
    logits = (2 * random(7)).requires_grad_()
    unsupervised = torch.tensor([True, False, False, True, False, False, False])
    (ours,) = torch.autograd.grad(uncertainty_loss(logits, unsupervised), logits)
    expected = [
        (1 / (1 + math.exp(-value)) - u) / (2 * (2 if u else 5))
        for value, u in zip(logits.tolist(), unsupervised.tolist(), strict=True)
    ]
    torch.testing.assert_close(ours, torch.tensor(expected, dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda x: uncertainty_loss(x, unsupervised), logits)
    far = torch.tensor([500.0, -500.0], requires_grad=True)
    loss = uncertainty_loss(far, torch.tensor([False, True]))
    assert loss.item() == pytest.approx(500)


# All of them.


def test_losses_of_meaning_do_not_depend_on_the_number_of_threads() -> None:
    rays = 2048
    logits = random(rays, 4).float().requires_grad_()
    rendered = random(rays, 512).float().requires_grad_()
    observed, confidence = random(rays, 512, seed=1).float(), random(rays).float().abs()
    classes = torch.from_numpy(stream(0, "classes").integers(0, 4, rays))

    def everything() -> tuple[bytes, ...]:
        losses = [
            semantic_loss(rendered, observed, confidence),
            focal_loss(logits, classes),
            uncertainty_loss(logits[:, 0], classes == 3),
        ]
        gradients = torch.autograd.grad(torch.stack(losses).sum(), [rendered, logits])
        return tuple(tensor.detach().numpy().tobytes() for tensor in (*losses, *gradients))

    before = torch.get_num_threads()
    try:
        results = set()
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            results.add(everything())
        assert len(results) == 1
    finally:
        torch.set_num_threads(before)
