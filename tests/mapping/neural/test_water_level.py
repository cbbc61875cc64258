"""The water level against trying every level."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from proground_log.mapping.neural.water_level import below_water_level


def staying_at(level: int, groups: list[int], ranks: list[int]) -> set[int]:
    """Each group's `level` rows of the lowest rank, ties by row."""
    return {
        row
        for group in set(groups)
        for row in sorted(
            (row for row, g in enumerate(groups) if g == group), key=lambda r: (ranks[r], r)
        )[:level]
    }


@given(
    rows=st.lists(st.tuples(st.integers(-3, 4), st.integers(0, 9)), max_size=40),
    most=st.integers(0, 45),
)
def test_it_is_the_highest_level_at_which_few_enough_stay(
    rows: list[tuple[int, int]], most: int
) -> None:
    groups, ranks = [group for group, _ in rows], [rank for _, rank in rows]
    level = max(n for n in range(len(rows) + 1) if len(staying_at(n, groups, ranks)) <= most)
    kept = below_water_level(np.array(groups, np.int64), np.array(ranks, np.uint32), most)
    if level == 0:
        # More groups than rows may stay: the luckiest of their first rows.
        firsts = sorted(staying_at(1, groups, ranks), key=lambda row: (ranks[row], groups[row]))
        assert sorted(ranks[row] for row in kept) == [ranks[row] for row in firsts[:most]]
        assert set(kept.tolist()) <= set(firsts)
        return
    assert kept.tolist() == sorted(staying_at(level, groups, ranks))
    for group in set(groups):
        assert sum(groups[row] == group for row in kept) == min(groups.count(group), level)


@pytest.mark.parametrize("offset", [0, -(2**40), 2**62])
def test_groups_and_ranks_may_be_as_large_as_their_types(offset: int) -> None:
    groups = np.array([2, 1, 2, 2, 1], np.int64) + offset
    ranks = np.array([2**32 - 1, 7, 0, 2**31, 2**32 - 1], np.uint32)
    assert below_water_level(groups, ranks, 4).tolist() == [1, 2, 3, 4]
    assert below_water_level(groups, ranks, 3).tolist() == [1, 2]
    assert below_water_level(groups, ranks, 1).tolist() == [2]
    assert below_water_level(groups, ranks, 0).tolist() == []
