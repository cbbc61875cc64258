"""Top-K accuracy: is the true name among the K that a map finds likeliest?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proground_log.errors import ProgroundError

KS = (1, 5, 10, 20, 50)
"""The paper's (Table 1)."""
COVERAGE_M = 0.05
_BLOCK = 4096


@dataclass(frozen=True)
class TopK:
    """How well a map names what is there (paper, Sec. 5.1).

    Args:
        points: how many were judged.
        candidates: among how many names.
        micro: share of points, in percent, whose true name is among the K likeliest, by K.
        macro: the same, as mean over the true names, so that small things count as large ones.
        per_class: points and Top-1 in percent by true name (its number among the candidates).
        area: under the curve of accuracy (0 to 1) over K: its mean for K = 1, 2, ... up to all
            candidates. 1 when the true name always comes first.
        coverage: share of points, in percent, within 5 cm of the map's surface, where known.
    """

    points: int
    candidates: int
    micro: dict[int, float]
    macro: dict[int, float]
    per_class: dict[int, tuple[int, float]]
    area: float
    coverage: float | None


def truth_ranks(logits: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """How many names a map finds at least as likely as the true one.

    Equals count against the map, and so does what is not a number: a map that finds all names
    equally likely knows nothing.

    Args:
        logits: [V, K], a column a candidate.
        truth: int [V], the true candidate; -1 for points that are not judged.

    Returns:
        int64 [V], 0 when the true name comes first; -1 for points that are not judged.

    >>> truth_ranks(np.array([[0.9, 0.2, 0.4], [0.1, 0.1, 0.1]]), np.array([2, 0])).tolist()
    [1, 2]
    """
    ranks = np.full(len(truth), -1)
    judged = np.flatnonzero(truth >= 0)
    for start in range(0, len(judged), _BLOCK):
        rows = judged[start : start + _BLOCK]
        block = logits[rows]
        own = np.take_along_axis(block, truth[rows, None], axis=1)
        ranks[rows] = logits.shape[1] - 1 - np.count_nonzero(block < own, axis=1)
    return ranks


def accuracy_of_ranks(
    ranks: np.ndarray,
    truth: np.ndarray,
    candidates: int,
    *,
    ks: Sequence[int] = KS,
    distances_m: np.ndarray | None = None,
) -> TopK:
    """Score the ranks of points: so that the logits of all need never be there at once.

    Args:
        ranks: int [V] of `truth_ranks`.
        truth: int [V], the true candidate; -1 for points that are not judged.
        candidates: how many names there are.
        ks: the K to report; those above `candidates` are left out, they say nothing.
        distances_m: [V] from each point to the nearest surface of the map, where known.

    Raises:
        ProgroundError: no point is judged.
    """
    judged = truth >= 0
    if not judged.any():
        raise ProgroundError(
            "no point has a label among the candidates",
            where="ground truth",
            todo="check the names and the mapping of labels to them",
        )
    ranks, truth = ranks[judged], truth[judged]
    sizes = np.bincount(truth, minlength=candidates)
    present = np.flatnonzero(sizes)

    def of_classes(k: int) -> np.ndarray:
        """Top-K in percent of each true name that is present."""
        hits = np.bincount(truth[ranks < k], minlength=candidates)
        return 100 * hits[present] / sizes[present]

    ks = [k for k in ks if k <= candidates]
    return TopK(
        points=len(truth),
        candidates=candidates,
        micro={k: 100 * float((ranks < k).mean()) for k in ks},
        macro={k: float(of_classes(k).mean()) for k in ks},
        per_class={
            int(name): (int(sizes[name]), float(top1))
            for name, top1 in zip(present, of_classes(1), strict=True)
        },
        # A point of rank r is right for all K but the first r.
        area=float(1 - ranks.mean() / candidates),
        coverage=(
            None if distances_m is None else 100 * float((distances_m[judged] <= COVERAGE_M).mean())
        ),
    )
