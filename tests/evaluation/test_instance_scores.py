"""Precision, recall and F1 of objects: on rows of points whose overlaps one can count."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.evaluation.instance_scores import (
    InstanceScores,
    find_crowds,
    score_instances,
)
from proground_log.streams import stream

ROW_M = np.stack([np.arange(40) * 0.2, np.zeros(40), np.zeros(40)], axis=1)


def score(
    truth: list[int], classes: list[str], objects: list[int], names: list[str]
) -> InstanceScores:
    pad = [-1] * 40
    true, found = np.array((truth + pad)[:40]), np.array((objects + pad)[:40])
    return score_instances(ROW_M, true, classes, ROW_M + np.array([0.03, 0, 0]), found, names)


def test_the_truth_itself_is_perfect() -> None:
    truth = [0] * 5 + [1] * 7 + [-1] * 3 + [2] * 4
    scores = score(truth, ["cup", "cup", "sofa"], truth, ["cup", "cup", "sofa"])
    for iou in (0.25, 0.5):
        assert scores.total.precision(iou) == scores.total.recall(iou) == scores.total.f1(iou) == 1
        assert scores.macro_f1(iou) == 1


def test_half_an_object_counts_at_a_quarter_and_not_at_a_half() -> None:
    scores = score([0] * 10, ["cup"], [0] * 4, ["cup"])
    assert scores.total.matched == {0.25: 1, 0.5: 0}
    scores = score([0] * 10, ["cup"], [0] * 5, ["cup"])
    assert scores.total.matched == {0.25: 1, 0.5: 1}


def test_merged_things_split_things_and_wrong_names_cost() -> None:
    merged = score([0] * 6 + [1] * 6, ["chair", "chair"], [0] * 12, ["chair"])
    assert (merged.total.precision(0.5), merged.total.recall(0.5)) == (1, 0.5)
    split = score([0] * 12, ["chair"], [0] * 8 + [1] * 4, ["chair", "chair"])
    assert (split.total.precision(0.5), split.total.recall(0.5)) == (0.5, 1)
    assert split.total.f1(0.5) == pytest.approx(2 / 3)
    wrong = score([0] * 12, ["chair"], [0] * 12, ["sofa"])
    assert wrong.total.f1(0.25) == 0
    assert (wrong.classes["chair"].found, wrong.classes["sofa"].found) == (0, 1)


def test_the_better_of_two_claims_wins_whatever_their_order() -> None:
    for names in ([0, 1], [1, 0]):
        found = [names[0]] * 3 + [names[1]] * 7
        scores = score([0] * 10, ["cup"], found, ["cup", "cup"])
        assert scores.total.matched == {0.25: 1, 0.5: 1}


def test_vertices_out_of_reach_are_of_no_object() -> None:
    truth = np.zeros(40, int)
    for shift_m, matched in ((0.049, 1), (0.051, 0)):
        moved_m = ROW_M + np.array([0, shift_m, 0])
        scores = score_instances(ROW_M, truth, ["cup"], moved_m, truth.copy(), ["cup"])
        assert scores.total.matched[0.5] == matched
        assert (scores.total.true, scores.total.found) == (1, 1)


def test_nothing_found_is_zero_and_macro_weighs_classes_alike() -> None:
    nothing = score([0] * 10, ["cup"], [], [])
    assert (nothing.total.precision(0.5), nothing.total.f1(0.5)) == (0, 0)
    truth = [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    scores = score(truth, ["book", "book", "book", "sofa"], [-1] * 9 + [0] * 3, ["sofa"])
    assert scores.total.f1(0.5) == pytest.approx(2 / 5)
    assert scores.macro_f1(0.5) == 0.5


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), kinds=st.integers(1, 3))
def test_matches_are_those_of_the_definition(seed: int, kinds: int) -> None:
    draw = stream(seed, "instances")
    true, found = (draw.integers(-1, 4, 40) for _ in range(2))
    true_names = [f"class {kind}" for kind in draw.integers(0, kinds, 4)]
    names = [f"class {kind}" for kind in draw.integers(0, kinds, 4)]
    overlap = []
    for t in range(4):
        for f in range(4):
            union = np.count_nonzero((true == t) | (found == f))
            shared = np.count_nonzero((true == t) & (found == f))
            if shared and true_names[t] == names[f]:
                overlap.append((-shared / union, t, f))
    free_t, free_f, ious = set(range(4)), set(range(4)), []
    for iou, t, f in sorted(overlap):
        if t in free_t and f in free_f:
            free_t.remove(t)
            free_f.remove(f)
            ious.append(-iou)
    scores = score(true.tolist(), true_names, found.tolist(), names)
    assert scores.total.matched == {x: sum(iou >= x for iou in ious) for x in (0.25, 0.5)}
    for iou in (0.25, 0.5):
        assert sum(c.matched[iou] for c in scores.classes.values()) == scores.total.matched[iou]


def crowds(objects: list[int], classes: list[str], nearer_than_m: float = 0.3) -> set[int]:
    numbers = np.array((objects + [-1] * 40)[:40])
    return set(find_crowds(ROW_M, numbers, classes, nearer_than_m))


def test_three_of_a_class_in_a_row_are_a_crowd_and_two_are_not() -> None:
    assert crowds([0, 0, 1, 1, 2, 2], ["book"] * 3) == {0, 1, 2}
    assert crowds([0, 0, 1, 1], ["book"] * 2) == set()
    # Something else between them, nothing between them, or another class beside them.
    assert crowds([0, 1, 2, 3], ["book", "book", "cup", "book"]) == set()
    assert crowds([0, 0, 1, 1, -1, 2, 2], ["book"] * 3) == set()
    assert crowds([3, 0, 1, 2, 4, -1, 5], ["book"] * 3 + ["cup"] * 2 + ["book"]) == {0, 1, 2}
    assert crowds([], []) == set()


def test_neighbours_are_as_near_as_is_said() -> None:
    for gap_m, found in ((0.199, set()), (0.201, {0, 1, 2})):
        assert crowds([0, 1, 2], ["book"] * 3, gap_m) == found


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), kinds=st.integers(1, 3))
def test_crowds_are_those_of_the_definition(seed: int, kinds: int) -> None:
    draw = stream(seed, "crowds")
    points_m, objects = draw.integers(0, 9, (30, 3)) * 0.5, draw.integers(-1, 9, 30)
    classes = [f"class {kind}" for kind in draw.integers(0, kinds, 9)]
    rows = [{number} for number in range(9)]
    for a, b in zip(*np.triu_indices(30, 1), strict=True):
        one, other = objects[[a, b]].tolist()
        near = np.linalg.norm(points_m[a] - points_m[b]) <= 1.0
        if near and min(one, other) >= 0 and classes[one] == classes[other]:
            row = rows[one] | rows[other]
            for number in row:
                rows[number] = row
    expected = {number for number in range(9) if len(rows[number]) >= 3}
    assert find_crowds(points_m, objects, classes, 1.0) == expected


def test_dense_objects_take_no_memory_for_their_near_pairs() -> None:
    """Of three objects of 4000 vertices all 72 million pairs are near: a gigabyte, if listed."""
    points_m = stream(0, "dense").uniform(0, 0.01, (12_000, 3))
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 200_000_000, limits[1]))
    try:
        assert find_crowds(points_m, np.arange(12_000) % 3, ["book"] * 3, 0.1) == {0, 1, 2}
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def test_a_row_is_a_chain_and_may_bend() -> None:
    points_m = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0.1, 0.1, 0.1], [5, 5, 5]])
    found = find_crowds(points_m, np.arange(5), ["book"] * 5, 0.11)
    assert found == {0, 1, 2, 3}


SHELF = [0, 0, 1, 1, 2, 2, 3, 3, 3, 3]
"""Three books in a row, and a cup."""
CLASSES = ["book", "book", "book", "cup"]


def shelf_scores(objects: list[int], names: list[str]) -> InstanceScores:
    true, found = (np.array((row + [-1] * 40)[:40]) for row in (SHELF, objects))
    return score_instances(ROW_M, true, CLASSES, ROW_M, found, names, crowds={0, 1, 2})


def test_what_is_found_on_a_crowd_is_neither_right_nor_wrong() -> None:
    found = [[0] * 6 + [1] * 4, [0, 0, 1, 1, 2, 2] + [3] * 4, [-1] * 6 + [0] * 4]
    names = [["book", "cup"], CLASSES, ["cup"]]
    for objects, classes in zip(found, names, strict=True):
        scores = shelf_scores(objects, classes)
        assert (scores.total.true, scores.total.found) == (1, 1)
        assert scores.total.matched == {0.25: 1, 0.5: 1}
        assert scores.classes["cup"].f1(0.5) == 1
        # A class that stands in crowds alone has no F1 of its own.
        assert scores.macro_f1(0.5) == 1


def test_another_class_on_a_crowd_and_what_lies_mostly_elsewhere_are_wrong() -> None:
    scores = shelf_scores([0] * 6 + [1] * 4, ["cup", "cup"])
    assert (scores.total.found, scores.total.matched[0.5]) == (2, 1)
    for beside, ignored in ((1, True), (2, False), (3, False)):
        row = [0, 0] + [-1] * 8 + [0] * beside
        scores = shelf_scores(row, ["book"])
        assert scores.total.found == (not ignored)


def test_a_book_that_stands_alone_is_judged_beside_a_crowd() -> None:
    true = np.array([0, 0, 1, 1, 2, 2, -1, -1, 3, 3] + [-1] * 30)
    # What is claimed lies on the lone book as well as, for the most part, on the crowd.
    found = np.array([-1] * 3 + [0, 0, 0, -1, -1, 0, 0] + [-1] * 30)
    books = ["book"] * 4
    lonely = find_crowds(ROW_M, true, books, 0.3)
    scores = score_instances(
        ROW_M, true, books, ROW_M, found, ["book"], crowds=lonely, ious=(0.25,)
    )
    assert (scores.total.true, scores.total.found, scores.total.matched) == (1, 1, {0.25: 1})


@pytest.mark.parametrize(("ious", "found"), [((0.25,), 0), ((0.1, 0.25), 1), ((0.5, 0.1), 1)])
def test_what_hardly_touches_a_book_that_stands_alone_is_no_claim_to_it(
    ious: tuple[float, ...], found: int
) -> None:
    true = np.array([0, 0, 1, 1, 2, 2, -1, -1, 3, 3] + [-1] * 30)
    # All of the crowd, and one vertex of the lone book's two: an IoU of 1 in 8.
    claimed = np.array([0] * 6 + [-1, -1, 0] + [-1] * 31)
    scores = score_instances(
        ROW_M, true, ["book"] * 4, ROW_M, claimed, ["book"], crowds={0, 1, 2}, ious=ious
    )
    assert (scores.total.true, scores.total.found) == (1, found)
    assert scores.total.matched == {iou: int(iou <= 1 / 8) for iou in ious}
