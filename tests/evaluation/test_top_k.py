"""Accuracies are those of a slow count, and a map that knows nothing gets nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.errors import ProgroundError
from proground_log.evaluation import top_k
from proground_log.evaluation.top_k import KS, TopK, accuracy_of_ranks, truth_ranks
from proground_log.streams import stream


def top_k_accuracy(
    logits: np.ndarray,
    truth: np.ndarray,
    *,
    ks: Sequence[int] = KS,
    distances_m: np.ndarray | None = None,
) -> TopK:
    """Score the logits of points; see `truth_ranks` and `accuracy_of_ranks`."""
    return accuracy_of_ranks(
        truth_ranks(logits, truth), truth, logits.shape[1], ks=ks, distances_m=distances_m
    )


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), points=st.integers(1, 80), names=st.integers(1, 30))
def test_every_figure_is_that_of_a_slow_count(seed: int, points: int, names: int) -> None:
    draw = stream(seed, "logits")
    # Few different values, so that there are ties.
    logits = draw.integers(8, size=(points, names)).astype(np.float32)
    truth = draw.integers(-1, names, size=points)
    truth[0] = names - 1
    distances_m = draw.uniform(0, 0.1, points)

    ranks: dict[int, list[int]] = {}
    near = []
    for row, name, distance_m in zip(logits, truth, distances_m, strict=True):
        if name >= 0:
            better = [o for o in range(names) if o != name and row[o] >= row[name]]
            ranks.setdefault(int(name), []).append(len(better))
            near.append(distance_m <= 0.05)
    every = [rank for of_name in ranks.values() for rank in of_name]

    result = top_k_accuracy(logits, truth, ks=(1, 3, 10, 50), distances_m=distances_m)
    assert (result.points, result.candidates) == (len(every), names)
    assert list(result.micro) == list(result.macro) == [k for k in (1, 3, 10, 50) if k <= names]
    for k, micro in result.micro.items():
        assert micro == pytest.approx(100 * np.mean([r < k for r in every]))
        per_class = [np.mean([r < k for r in of_name]) for of_name in ranks.values()]
        assert result.macro[k] == pytest.approx(100 * np.mean(per_class))
    assert result.per_class == {
        name: (len(ranks[name]), pytest.approx(100 * np.mean([r < 1 for r in ranks[name]])))
        for name in sorted(ranks)
    }
    curve = [np.mean([r < k for r in every]) for k in range(1, names + 1)]
    assert result.area == pytest.approx(np.mean(curve))
    assert result.coverage == pytest.approx(100 * np.mean(near))


def test_blocks_leave_no_seam() -> None:
    draw = stream(1, "blocks")
    points = 2 * top_k._BLOCK + 5
    logits = draw.normal(size=(points, 7)).astype(np.float32)
    truth = draw.integers(-1, 7, size=points)
    order = np.argsort(-logits, axis=1).argsort(axis=1)
    expected = np.where(truth < 0, -1, order[np.arange(points), truth])
    np.testing.assert_array_equal(truth_ranks(logits, truth), expected)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -np.inf])
def test_a_map_that_finds_all_names_equal_scores_nothing(value: float) -> None:
    result = top_k_accuracy(np.full((10, 60), value, np.float32), np.arange(10))
    assert set(result.micro.values()) == set(result.macro.values()) == {0}
    assert result.area == pytest.approx(1 / 60)


def test_a_rival_that_is_no_number_counts_against_the_map() -> None:
    logits = np.array([[2.0, np.nan, 1.0]], np.float32)
    assert truth_ranks(logits, np.array([0])).tolist() == [1]


def test_a_perfect_map_has_all() -> None:
    truth = np.array([0, 0, 0, 1, 2])
    result = top_k_accuracy(np.eye(60, dtype=np.float32)[truth], truth)
    assert result.micro == result.macro == {1: 100, 5: 100, 10: 100, 20: 100, 50: 100}
    assert result.per_class == {0: (3, 100), 1: (1, 100), 2: (1, 100)}
    assert (result.area, result.coverage) == (1, None)


def test_macro_counts_small_things_as_large_ones() -> None:
    truth = np.array([0] * 9 + [1])
    always_first = np.tile(np.array([1.0, 0.0], np.float32), (10, 1))
    result = top_k_accuracy(always_first, truth)
    assert (result.micro[1], result.macro[1]) == (90, 50)


def test_ranks_by_parts_score_as_all_at_once() -> None:
    draw = stream(2, "parts")
    logits = draw.normal(size=(100, 12)).astype(np.float32)
    truth = draw.integers(-1, 12, size=100)
    parts = [truth_ranks(logits[i : i + 30], truth[i : i + 30]) for i in range(0, 100, 30)]
    by_parts = accuracy_of_ranks(np.concatenate(parts), truth, 12)
    assert by_parts == top_k_accuracy(logits, truth)


def test_a_truth_without_a_name_is_refused() -> None:
    with pytest.raises(ProgroundError, match="no point has a label among the candidates"):
        top_k_accuracy(np.zeros((3, 2), np.float32), np.full(3, -1))
