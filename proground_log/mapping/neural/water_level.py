"""The rule by which bounded memories make room: the crowded give way, the rare stay."""

from __future__ import annotations

import numpy as np


def below_water_level(groups: np.ndarray, ranks: np.ndarray, most: int) -> np.ndarray:
    """The rows that stay when each group keeps no more than a common water level allows.

    Args:
        groups: int64 [N], the group of each row.
        ranks: uint32 [N]; within a group those of the lowest rank stay, ties by row.
        most: how many rows may stay in all.

    Returns:
        Row numbers, ascending: those at the highest level at which they are `most` or fewer. Where
        there are more groups than that, of the groups' first rows those of the lowest rank.
    """
    order = np.lexsort((ranks, groups))
    sorted_groups = groups[order]
    first_of_group = np.concatenate([[True], sorted_groups[1:] != sorted_groups[:-1]])
    starts = np.flatnonzero(first_of_group[: len(order)])
    position = np.arange(len(order)) - starts[np.cumsum(first_of_group[: len(order)]) - 1]
    # Entry n: how many rows stay when each group keeps its first n + 1.
    staying = np.cumsum(np.bincount(position))
    level = int(np.searchsorted(staying, most, side="right"))
    if level == 0:
        firsts = order[position == 0]
        return np.sort(firsts[np.argsort(ranks[firsts], kind="stable")[:most]])
    return np.sort(order[position < level])
