"""From scores of vertices to things: where each one is, how large, how sure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

EXTENT_PERCENTILES = (2, 98)
"""An extent leaves out so much on either side: a few stray vertices would stretch it."""
GAP_VOXELS = 3
"""Vertices this near are of one thing: a crack of a voxel or two must not split it."""


@dataclass(frozen=True)
class Instance:
    """One thing that was found.

    Args:
        position_m: float64 [3], world axes: the centre of its vertices, weighted by their scores;
            those outside its extent count at the extent's border.
        lower_m, upper_m: float64 [3], its extent: 2nd and 98th percentile of its vertices.
        score: how sure it is, up to 1 where it is a relevance.
        vertices: int64 [N], numbers of its vertices, rising.
    """

    position_m: np.ndarray
    lower_m: np.ndarray
    upper_m: np.ndarray
    score: float
    vertices: np.ndarray

    def __len__(self) -> int:
        return len(self.vertices)


def find_instances(
    vertices_m: np.ndarray,
    faces: np.ndarray | None,
    scores: np.ndarray,
    *,
    threshold: float,
    most_gap_m: float,
    least_vertices: int,
) -> list[Instance]:
    """Group the vertices that score well into things (paper, Sec. 5.3).

    Args:
        vertices_m: [V, 3], world axes.
        faces: int [F, 3], numbers of vertices, or None where there are points only.
        scores: [V], for instance of `relevance_to`.
        threshold: vertices count from this score on; positive.
        most_gap_m: two vertices are of one thing if a face joins them, if they are no farther
            apart than this, or if a chain of such pairs leads from one to the other. Time and
            memory grow with the pairs this near, so choose a few times the vertices' spacing.
        least_vertices: smaller groups are dropped.

    Returns:
        The things by falling score, then falling size, then position.
    """
    chosen = np.flatnonzero(scores >= threshold)
    if not len(chosen):
        return []
    pairs = cKDTree(vertices_m[chosen]).query_pairs(most_gap_m, output_type="ndarray")
    if faces is not None:
        pairs = np.concatenate([pairs, _joined_by_faces(faces, chosen, len(vertices_m))])
    links = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(chosen),) * 2)
    _, group = connected_components(links, directed=False)
    sizes = np.bincount(group)
    members = np.split(chosen[np.argsort(group, kind="stable")], np.cumsum(sizes)[:-1])
    found = [
        instance_of(vertices_m, m, scores[m].astype(np.float64), _score(scores[m], least_vertices))
        for m in members
        if len(m) >= least_vertices
    ]
    return sorted(found, key=lambda thing: (-thing.score, -len(thing), *thing.position_m))


def _joined_by_faces(faces: np.ndarray, chosen: np.ndarray, count: int) -> np.ndarray:
    """Pairs [E, 2] of places in `chosen` that an edge of a face joins."""
    place = np.full(count, -1)
    place[chosen] = np.arange(len(chosen))
    corners = place[faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return edges[(edges >= 0).all(axis=1)]


def instance_of(
    vertices_m: np.ndarray, members: np.ndarray, weights: np.ndarray, score: float
) -> Instance:
    """The thing that some vertices are.

    Args:
        vertices_m: [V, 3], world axes.
        members: int64 [N], numbers of its vertices, rising.
        weights: [N], how much each counts for its position.
        score: how sure it is.
    """
    points_m = vertices_m[members].astype(np.float64)
    lower_m, upper_m = np.percentile(points_m, EXTENT_PERCENTILES, axis=0)
    position_m = np.average(points_m.clip(lower_m, upper_m), axis=0, weights=weights)
    return Instance(position_m, lower_m, upper_m, score, members)


def _score(relevance: np.ndarray, least_vertices: int) -> float:
    """Mean of the better half, less for what is small.

    At its rim relevance always fades, and a mean over all would count that against small things;
    and a speck that is sure of itself must not come before a sofa.
    """
    count = len(relevance)
    better = np.sort(relevance)[count // 2 :]
    return float(better.mean()) * count / (count + least_vertices)
