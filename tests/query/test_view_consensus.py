"""Which regions are of one thing: against the definitions, computed slowly on small scenes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.query.association import CONSENSUS, associate, consensus, contract
from proground_log.query.sightings import Sightings
from proground_log.streams import stream
from tests.query.sheets import Look, sightings_of


def random_weights(seed: int, count: int) -> np.ndarray:
    """Symmetric, of both signs, no two alike."""
    upper = np.triu(stream(seed, "weights").normal(0, 1, (count, count)), 1)
    return upper + upper.T


def slow_contract(weights: np.ndarray) -> list[int]:
    """By the definition: of all pairs of groups, join the one whose weights sum up to most."""
    groups = [[number] for number in range(len(weights))]
    while True:
        sums = {
            (a, b): weights[np.ix_(groups[a], groups[b])].sum()
            for b in range(len(groups))
            for a in range(b)
        }
        pair = max(sums, key=lambda pair: sums[pair], default=None)
        if pair is None or sums[pair] <= 0:
            return [min(group) for n in range(len(weights)) for group in groups if n in group]
        a, b = pair
        groups[a] += groups.pop(b)


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 14))
def test_contraction_is_that_of_its_definition(seed: int, count: int) -> None:
    weights = random_weights(seed, count)
    given_weights = weights.copy()
    np.testing.assert_array_equal(contract(weights), slow_contract(weights))
    np.testing.assert_array_equal(weights, given_weights)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(2, 30))
def test_contraction_does_not_depend_on_the_order(seed: int, count: int) -> None:
    weights = random_weights(seed, count)
    order = stream(seed, "order").permutation(count)
    groups, shuffled = contract(weights), contract(weights[np.ix_(order, order)])
    np.testing.assert_array_equal(
        shuffled[:, None] == shuffled, groups[order][:, None] == groups[order]
    )


def test_what_neither_agrees_nor_disagrees_stays_apart() -> None:
    np.testing.assert_array_equal(contract(np.zeros((3, 3))), [0, 1, 2])
    # Two that are alike, and a third that fits one of them but not both.
    weights = np.array([[0, 3, 2], [3, 0, -4], [2, -4, 0]], float)
    np.testing.assert_array_equal(contract(weights), [0, 0, 2])


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 12))
def test_with_ties_too_no_two_groups_that_agree_are_left(seed: int, count: int) -> None:
    weights = np.sign(random_weights(seed, count)) + np.round(random_weights(seed + 1, count))
    groups = contract(weights)
    members = groups == np.unique(groups)[:, None]
    between = members @ weights @ members.T
    assert (between[~np.eye(len(members), dtype=bool)] <= 0).all()
    assert (np.diag(between) >= 0).all()


def random_looks(seed: int) -> tuple[list[Look], int]:
    """Frames that see parts of a few dozen vertices, with regions at random."""
    draw = stream(seed, "looks")
    vertices = int(draw.integers(1, 40))
    looks = []
    for _ in range(draw.integers(1, 6)):
        seen = draw.random(vertices) < draw.uniform(0.2, 1)
        region = np.where(seen, draw.integers(-1, 3, vertices), -1)
        found = [region == number for number in range(3) if (region == number).any()]
        looks.append((seen, found))
    return looks, vertices


def slow_consensus(looks: list[Look]) -> tuple[np.ndarray, np.ndarray]:
    masks = [mask for _, regions in looks for mask in regions]
    same, seen = np.zeros((2, len(masks), len(masks)))
    for a, first in enumerate(masks):
        for b, second in enumerate(masks):
            for saw, regions in looks:
                sizes = [np.count_nonzero(mask & saw) for mask in (first, second)]
                if 10 * sizes[0] < 3 * first.sum() or 10 * sizes[1] < 3 * second.sum():
                    continue
                shares = [
                    [np.count_nonzero(mask & region) / n for region in regions]
                    for mask, n in zip((first, second), sizes, strict=True)
                ]
                same[a, b] += sum(x * y for x, y in zip(*shares, strict=True))
                seen[a, b] += 1 - (1 - sum(shares[0])) * (1 - sum(shares[1]))
    return same, seen


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_consensus_is_that_of_its_definition(seed: int) -> None:
    looks, vertices = random_looks(seed)
    found = consensus(sightings_of(looks, vertices))
    for mine, expected in zip(found, slow_consensus(looks), strict=True):
        assert mine.dtype == np.float64
        np.testing.assert_allclose(mine, expected, atol=1e-5)
        np.testing.assert_array_equal(mine, mine.T)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_order_of_frames_and_regions_does_not_change_a_bit(seed: int) -> None:
    looks, vertices = random_looks(seed)
    turned = [(saw, regions[::-1]) for saw, regions in looks[::-1]]
    both = zip(
        consensus(sightings_of(looks, vertices)),
        consensus(sightings_of(turned, vertices)),
        strict=True,
    )
    for one, other in both:
        np.testing.assert_array_equal(one, other[::-1, ::-1])


def band(*places: range) -> np.ndarray:
    """Some of twenty vertices in a row."""
    chosen = np.zeros(20, bool)
    for place in places:
        chosen[place] = True
    return chosen


EVERYTHING = band(range(20))
LEFT, RIGHT = band(range(3, 9)), band(range(9, 15))


def groups_of(sightings: Sightings) -> list[list[int]]:
    groups = associate(sightings)
    assert groups.dtype == np.int64
    firsts = [groups.tolist().index(number) for number in range(groups.max() + 1)]
    assert firsts == sorted(firsts)
    return [np.flatnonzero(groups == number).tolist() for number in range(groups.max() + 1)]


@pytest.mark.parametrize("merged", [0, 2, 5])
def test_what_a_few_frames_take_for_one_stays_two(merged: int) -> None:
    apart = [(EVERYTHING, [LEFT, RIGHT])] * 15
    looks = [*apart[:7], *[(EVERYTHING, [LEFT | RIGHT])] * merged, *apart[7:]]
    sightings = sightings_of(looks, 20)
    sizes = sightings.regions.sum(axis=0)
    whole = set(np.flatnonzero(sizes == 12).tolist())
    groups = [set(group) - whole for group in groups_of(sightings)]
    left = {n for n in range(len(sightings)) if sightings.regions[[3], [n]].item()} - whole
    assert {frozenset(group) for group in groups if group} == {
        frozenset(left),
        frozenset(range(len(sightings))) - left - whole,
    }


def test_what_most_frames_take_for_one_is_one() -> None:
    looks = [(EVERYTHING, [LEFT, RIGHT])] * 4 + [(EVERYTHING, [LEFT | RIGHT])] * 12
    assert groups_of(sightings_of(looks, 20)) == [[*range(20)]]


@pytest.mark.parametrize(("shared", "groups"), [(34, [[0], [1]]), (36, [[0, 1]])])
def test_two_are_one_if_more_than_the_stated_share_agrees(
    shared: int, groups: list[list[int]]
) -> None:
    """Each of two frames says "the same" of so many hundredths of its region and the other's."""
    assert CONSENSUS == 0.35
    places = np.arange(200 - shared)
    first, second = places < 100, places >= 100 - shared
    everything = np.ones(len(places), bool)
    looks = [(everything, [first]), (everything, [second])]
    assert groups_of(sightings_of(looks, len(places))) == groups


def test_frames_that_see_only_one_of_two_say_nothing_of_both() -> None:
    """What is never seen together is not joined, even through what hides between."""
    left, right = (band(range(10)), [LEFT]), (band(range(9, 20)), [RIGHT])
    same, seen = consensus(sightings_of([left, right, left], 20))
    np.testing.assert_array_equal(seen > 0, [[1, 0, 1], [0, 1, 0], [1, 0, 1]])
    np.testing.assert_array_equal(same, seen)
    assert groups_of(sightings_of([left, right, left], 20)) == [[0, 2], [1]]


def test_frames_that_found_nothing_say_nothing() -> None:
    looks = [(EVERYTHING, [LEFT]), (EVERYTHING, [LEFT])]
    blind = [(EVERYTHING, [])] * 30
    for more in ([], blind):
        _, seen = consensus(sightings_of([*looks, *more], 20))
        np.testing.assert_array_equal(seen, np.full((2, 2), 2.0))
    assert groups_of(sightings_of([*looks, *blind], 20)) == [[0, 1]]


def test_nothing_found_is_no_group() -> None:
    for looks in ([], [(EVERYTHING, [])]):
        groups = associate(sightings_of(looks, 20))
        assert groups.dtype == np.int64
        assert len(groups) == 0
