"""Objects against the true ones: precision, recall and F1."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

REACH_M = 0.05
"""A true vertex is what the map's nearest vertex within this is of."""
CROWD = 3
"""So many objects of one class in a row, each near the next, are a crowd."""


@dataclass(frozen=True)
class InstanceCounts:
    """How many objects there are, were found, and were found rightly.

    Args:
        true, found: objects of the class.
        matched: pairs of a true and a found one, by the least IoU of a pair.
    """

    true: int
    found: int
    matched: dict[float, int]

    def precision(self, iou: float) -> float:
        """Share of the found objects that are true, 0 where none was found."""
        return self.matched[iou] / self.found if self.found else 0.0

    def recall(self, iou: float) -> float:
        """Share of the true objects that were found, 0 where there are none."""
        return self.matched[iou] / self.true if self.true else 0.0

    def f1(self, iou: float) -> float:
        """Harmonic mean of both: 2 m / (t + f)."""
        return 2 * self.matched[iou] / max(self.true + self.found, 1)


@dataclass(frozen=True)
class InstanceScores:
    """How well objects are told apart.

    Args:
        total: over all classes.
        classes: by name of the class, of the true and of the found ones.
    """

    total: InstanceCounts
    classes: dict[str, InstanceCounts]

    def macro_f1(self, iou: float) -> float:
        """Mean F1 of the classes that are there, so that forty books do not outweigh the rest."""
        f1 = [counts.f1(iou) for counts in self.classes.values() if counts.true]
        return float(np.mean(f1)) if f1 else 0.0


def score_instances(
    true_vertices_m: np.ndarray,
    true_objects: np.ndarray,
    true_classes: Sequence[str],
    vertices_m: np.ndarray,
    objects: np.ndarray,
    classes: Sequence[str],
    *,
    crowds: Collection[int] = (),
    ious: Sequence[float] = (0.25, 0.5),
) -> InstanceScores:
    """Match found objects to true ones.

    Both are sets of the truth's vertices: a vertex is of the found object that the nearest vertex
    of the map is of, if it lies within `REACH_M`, and of none otherwise. So how densely the map's
    mesh is cut does not matter, and what nobody knows the truth of is not judged. Pairs of one
    class are matched one to one by falling IoU, then by rising numbers.

    Crowds are treated as in COCO (Lin et al., ECCV 2014): they need not be found, and what is found
    and lies for the most part on those of its class is not counted either, unless it is matched.

    Args:
        true_vertices_m: float [T, 3].
        true_objects: int [T], number of the object that a vertex is of, -1 for none.
        true_classes: class of each true object.
        vertices_m: float [V, 3], of the map.
        objects: int [V], number of the found object, -1 for none.
        classes: class of each found object.
        crowds: numbers of the true objects that stand in crowds; see `find_crowds`.
        ious: a pair counts from these on (intersection over union).
    """
    distance_m, nearest = cKDTree(vertices_m).query(true_vertices_m)
    found_objects = np.where(distance_m <= REACH_M, objects[nearest], -1)
    in_pair = (true_objects >= 0) & (found_objects >= 0)
    shape = len(true_classes), len(classes)
    pairs = true_objects[in_pair], found_objects[in_pair]
    shared = coo_array((np.ones(int(in_pair.sum()), np.int64), pairs), shape=shape).tocsr().tocoo()
    true_sizes = np.bincount(true_objects[true_objects >= 0], minlength=shape[0])
    found_sizes = np.bincount(found_objects[found_objects >= 0], minlength=shape[1])
    union = true_sizes[shared.row] + found_sizes[shared.col] - shared.data
    overlaps = zip(shared.data / union, shared.row.tolist(), shared.col.tolist(), strict=True)
    matched_iou: dict[int, float] = {}
    taken: set[int] = set()
    for iou, true, found in sorted(overlaps, key=lambda pair: (-pair[0], *pair[1:])):
        is_free = true not in matched_iou and found not in taken and true not in crowds
        if iou >= min(ious) and is_free and true_classes[true] == classes[found]:
            matched_iou[true] = float(iou)
            taken.add(found)

    parts = shared.row.tolist(), shared.col.tolist(), shared.data.tolist()
    on_crowds = np.zeros(len(classes), np.int64)
    for true, found, vertices in zip(*parts, strict=True):
        if true in crowds and true_classes[true] == classes[found]:
            on_crowds[found] += vertices
    ignored = {n for n in np.flatnonzero(2 * on_crowds > found_sizes).tolist() if n not in taken}
    judged = [name for n, name in enumerate(true_classes) if n not in crowds]
    claims = [name for n, name in enumerate(classes) if n not in ignored]

    def counts(wanted: Sequence[str]) -> InstanceCounts:
        scores = [iou for true, iou in matched_iou.items() if true_classes[true] in wanted]
        return InstanceCounts(
            true=sum(name in wanted for name in judged),
            found=sum(name in wanted for name in claims),
            matched={least: sum(iou >= least for iou in scores) for least in ious},
        )

    names = sorted({*true_classes, *classes})
    return InstanceScores(counts(names), {name: counts([name]) for name in names})


def find_crowds(
    vertices_m: np.ndarray, objects: np.ndarray, classes: Sequence[str], nearer_than_m: float
) -> frozenset[int]:
    """The objects that stand in crowds: books on a shelf.

    Args:
        vertices_m: float [T, 3].
        objects: int [T], number of the object that a vertex is of, -1 for none.
        classes: class of each object.
        nearer_than_m: two of one class with vertices this near are neighbours.

    Returns:
        The numbers of those in rows of `CROWD` or more neighbours.
    """
    trees = [cKDTree(vertices_m[objects == number]) for number in range(len(classes))]
    links = np.zeros((len(classes),) * 2, bool)
    for first, second in combinations(range(len(classes)), 2):
        if classes[first] == classes[second]:
            # Counted, not listed: dense meshes have more near pairs than fit into memory.
            near = trees[first].count_neighbors(trees[second], nearer_than_m)
            links[first, second] = near > 0
    _, row = connected_components(links, directed=False)
    return frozenset(np.flatnonzero(np.bincount(row)[row] >= CROWD).tolist())
