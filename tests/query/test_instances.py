"""Things are groups of vertices that score: checked against chains of neighbours, found slowly."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.query.instances import Instance, find_instances
from proground_log.streams import stream


def sheet(corner_m: tuple[float, float, float], rows: int, columns: int) -> np.ndarray:
    """Points 10 cm apart in a horizontal rectangle."""
    grid = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=-1)
    flat = grid.reshape(-1, 2) * 0.1
    return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1) + corner_m


def find(points_m: np.ndarray, scores: np.ndarray, **options: float) -> list[Instance]:
    chosen = {"threshold": 0.5, "most_gap_m": 0.15, "least_vertices": 1, **options}
    return find_instances(points_m, None, scores, **chosen)  # type: ignore[arg-type]


def slow_groups(
    points_m: np.ndarray, faces: np.ndarray | None, chosen: np.ndarray, gap_m: float
) -> set[frozenset[int]]:
    """Groups of chosen vertices by flooding, one vertex after the other."""
    faces = np.zeros((0, 3), int) if faces is None else faces
    left, groups = set(map(int, chosen)), set()
    while left:
        group, front = set(), [min(left)]
        while front:
            vertex = front.pop()
            if vertex not in left:
                continue
            left.remove(vertex)
            group.add(vertex)
            near = np.flatnonzero(np.linalg.norm(points_m - points_m[vertex], axis=1) <= gap_m)
            joined = faces[(faces == vertex).any(axis=1)].reshape(-1)
            front += [*map(int, near), *map(int, joined)]
        groups.add(frozenset(group))
    return groups


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 60),
    gap_m=st.sampled_from([0.01, 0.1, 0.3]),
    with_faces=st.booleans(),
    least=st.integers(1, 4),
)
def test_groups_are_those_of_slow_flooding(
    seed: int, count: int, gap_m: float, with_faces: bool, least: int
) -> None:
    draw = stream(seed, "points")
    points_m = draw.random((count, 3))
    scores = draw.random(count)
    faces = draw.integers(count, size=(count // 4, 3)) if with_faces else None
    found = find_instances(
        points_m, faces, scores, threshold=0.4, most_gap_m=gap_m, least_vertices=least
    )
    expected = slow_groups(points_m, faces, np.flatnonzero(scores >= 0.4), gap_m)
    assert {frozenset(map(int, thing.vertices)) for thing in found} == {
        group for group in expected if len(group) >= least
    }
    for thing in found:
        assert (np.diff(thing.vertices) > 0).all()
        assert (thing.lower_m <= thing.position_m + 1e-12).all()
        assert (thing.position_m <= thing.upper_m + 1e-12).all()
    order = [(-thing.score, -len(thing)) for thing in found]
    assert order == sorted(order)


def test_two_things_are_told_apart_placed_and_measured() -> None:
    points_m = np.concatenate([sheet((0, 0, 0), 6, 11), sheet((2, 0, 1), 5, 5)])
    scores = np.concatenate([np.full(66, 0.6), np.full(25, 0.9)])
    second, first = find(points_m, scores)
    np.testing.assert_allclose(first.position_m, (0.25, 0.5, 0), atol=1e-9)
    np.testing.assert_allclose(second.position_m, (2.2, 0.2, 1), atol=1e-9)
    np.testing.assert_allclose(first.upper_m - first.lower_m, (0.5, 1, 0), atol=0.02)
    assert (first.score, second.score) == pytest.approx((0.6 * 66 / 67, 0.9 * 25 / 26))


def test_faces_join_what_a_gap_would_part() -> None:
    points_m = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0]])
    scores = np.array([0.9, 0.9, 0.2, 0.9, 0.9])
    faces = np.array([[0, 1, 2], [2, 3, 4]])  # they share a vertex that does not score
    found = find_instances(points_m, faces, scores, threshold=0.5, most_gap_m=0.1, least_vertices=1)
    assert [list(thing.vertices) for thing in found] == [[0, 1], [3, 4]]


def test_a_spike_hardly_moves_or_stretches_a_thing() -> None:
    points_m = np.concatenate([sheet((0, 0, 0), 20, 20), [[40, 0, 0]]])
    (thing,) = find_instances(
        points_m,
        np.array([[0, 1, 400]]),
        np.ones(401),
        threshold=0.5,
        most_gap_m=0.15,
        least_vertices=1,
    )
    assert len(thing) == 401
    assert thing.upper_m[0] < 1.95
    np.testing.assert_allclose(thing.position_m, (0.95, 0.95, 0), atol=0.01)


def test_a_fading_rim_does_not_lower_the_score() -> None:
    points_m = sheet((0, 0, 0), 1, 10)
    (thing,) = find(points_m, np.array([0.5, 0.5, 0.6, 0.9, 0.9, 0.9, 0.9, 0.9, 0.6, 0.5]))
    assert thing.score == pytest.approx(0.9 * 10 / 11)
    (one,) = find(points_m[:1], np.array([0.7]))
    assert one.score == pytest.approx(0.7 / 2)


def test_the_centre_leans_to_the_better_vertices() -> None:
    points_m = sheet((0, 0, 0), 1, 10)
    (thing,) = find(points_m, np.where(np.arange(10) < 5, 0.5, 1.0))
    assert thing.position_m[1] > 0.5


def test_equal_scores_go_by_size_then_position_whatever_the_order_of_vertices() -> None:
    sheets = [sheet((x, 0, 0), n, 3) for x, n in ((6, 3), (4, 2), (2, 2), (0, 2))]
    points_m = np.concatenate(sheets)
    order = stream(1, "order").permutation(len(points_m))
    for points in (points_m, points_m[order]):
        found = find(points, np.full(len(points), 0.75))
        assert [len(thing) for thing in found] == [9, 6, 6, 6]
        np.testing.assert_allclose([t.position_m[0] for t in found], [6.1, 0.05, 2.05, 4.05])


def test_where_nothing_scores_there_is_nothing() -> None:
    points_m = sheet((0, 0, 0), 3, 3)
    assert find(points_m, np.full(9, 0.4)) == []
    assert find(points_m, np.full(9, np.nan)) == []
    assert find(points_m, np.ones(9), least_vertices=10) == []
    assert find(np.zeros((0, 3)), np.zeros(0)) == []


def test_each_chair_of_a_real_house_is_one_thing(shared_data: Path) -> None:
    content = (shared_data / "aws_small_house_labelled/mesh_semantic_observed.ply").read_bytes()
    vertices_m, labels, instances = read_labelled_mesh(content, where="house")
    assert instances is not None
    faces = trimesh.load_mesh(BytesIO(content), file_type="ply", process=False).faces
    scores = (labels == 6).astype(np.float32)
    chairs = find_instances(
        vertices_m, faces, scores, threshold=0.5, most_gap_m=0.1, least_vertices=30
    )
    expected = [i for i in np.unique(instances[labels == 6]) if np.sum(instances == i) >= 30]
    assert sorted(int(instances[chair.vertices[0]]) for chair in chairs) == expected
    for chair in chairs:
        (own,) = np.unique(instances[chair.vertices])
        true_m = vertices_m[instances == own]
        np.testing.assert_allclose(chair.position_m, true_m.mean(axis=0), atol=0.02)
