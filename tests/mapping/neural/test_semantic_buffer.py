"""The memory of meaning: bounded, fair to rare labels, and no embedding held twice or in vain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.mapping.neural import semantic_buffer
from proground_log.mapping.neural.semantic_buffer import RegionTable, SemanticBuffer, SemanticRays
from proground_log.regions import EMBEDDING_WIDTH, Regions
from proground_log.streams import stream

Pair = tuple[int, int]
"""A label and a level."""
CHAIR, LAMP = (0, 2), (5, 0)


def keyframe(number: int, *regions: tuple[Pair, int]) -> tuple[SemanticRays, RegionTable]:
    """Regions, each with its pair and number of rays; every ray and embedding tells its own."""
    pairs, counts = [pair for pair, _ in regions], [count for _, count in regions]
    of = np.repeat(np.arange(len(regions), dtype=np.int32), counts)
    embeddings = np.zeros((len(regions), EMBEDDING_WIDTH), np.float16)
    embeddings[:, 0], embeddings[:, 1] = number, np.arange(len(regions))
    table = RegionTable(
        embeddings,
        confidence=np.linspace(0.5, 0.9, len(regions), dtype=np.float32),
        levels=np.array([level for _, level in pairs], np.uint8),
        labels=np.array([label for label, _ in pairs], np.int32),
    )
    origins_m = np.zeros((len(of), 3), np.float32)
    origins_m[:, 0], origins_m[:, 1], origins_m[:, 2] = number, of, np.arange(len(of))
    rays = SemanticRays(origins_m, origins_m + 0.5, np.arange(1, len(of) + 1, dtype=np.float32), of)
    return rays, table


def insert(buffer: SemanticBuffer, number: int, *regions: tuple[Pair, int]) -> int:
    return buffer.insert(*keyframe(number, *regions), stream(0, "buffer", number))


def held(buffer: SemanticBuffer) -> dict[Pair, int]:
    """Rays held by pair, after a check that each ray still has its own region."""
    rays = buffer.take(np.arange(len(buffer)))
    table = buffer.table
    of = table.take(rays.regions)
    np.testing.assert_array_equal(rays.origins_m[:, :2], of.embeddings[:, :2])
    np.testing.assert_array_equal(rays.directions, rays.origins_m + 0.5)
    np.testing.assert_array_equal(rays.depth_m, rays.origins_m[:, 2] + 1)
    # No region twice, and none without rays.
    assert len(np.unique(table.embeddings[:, :2], axis=0)) == len(table)
    np.testing.assert_array_equal(np.unique(rays.regions), np.arange(len(table)))
    pairs, counts = np.unique(np.stack([of.labels, of.levels], 1), axis=0, return_counts=True)
    return {(int(a), int(b)): int(n) for (a, b), n in zip(pairs, counts, strict=True)}


def test_a_rare_pair_keeps_its_rays_while_a_crowded_one_is_thinned() -> None:
    buffer = SemanticBuffer(300, 0.5)
    insert(buffer, 0, (LAMP, 40), (CHAIR, 20))
    lamp = buffer.take(np.arange(40)).origins_m
    for number in range(1, 100):
        insert(buffer, number, (CHAIR, 30), (CHAIR, 25))
        assert len(buffer) <= 300
    now = held(buffer)
    assert now[LAMP] == 40
    assert 270 - 40 - 55 <= now[CHAIR] <= 260
    rays = buffer.take(np.arange(len(buffer)))
    np.testing.assert_array_equal(rays.origins_m[rays.origins_m[:, 0] == 0][:40], lamp)


def test_one_label_at_two_levels_is_two_pairs() -> None:
    buffer = SemanticBuffer(100, 0.5)
    insert(buffer, 0, ((3, 0), 30), ((3, 1), 200))
    assert held(buffer) == {(3, 0): 30, (3, 1): 60}
    # Label 0 at level 3, were there one, would be label 1 at level 0.
    insert(buffer, 1, ((0, 2), 5), ((1, 0), 5))
    assert held(buffer) == {(3, 0): 30, (3, 1): 60, (0, 2): 5, (1, 0): 5}


def test_within_a_pair_old_and_new_rays_have_the_same_chance() -> None:
    buffer = SemanticBuffer(400, 0.5)
    for number in range(40):
        insert(buffer, number, (CHAIR, 100))
    of_keyframe = buffer.take(np.arange(len(buffer))).origins_m[:, 0].astype(int)
    counts = np.bincount(of_keyframe, minlength=40)
    # 10 of each keyframe's 100 are expected; a purge by age would leave 0 or 100.
    assert (counts > 0).all()
    assert counts.max() < 30
    assert 130 < counts[:20].sum() < 250


def test_an_embedding_is_held_once_a_region_and_forgotten_with_its_last_ray() -> None:
    buffer = SemanticBuffer(50, 0.5)
    insert(buffer, 0, (CHAIR, 30), (LAMP, 10))
    assert len(buffer.table) == 2
    # A region that no ray was chosen of is not kept at all.
    insert(buffer, 1, (CHAIR, 5), ((1, 1), 0))
    assert len(buffer.table) == 3
    held(buffer)
    state = buffer.state()
    assert state["table/embeddings"].shape == (3, EMBEDDING_WIDTH)
    assert state["table/embeddings"].dtype == np.float16
    # A crowd of regions of one ray each: most give way, and so do their embeddings.
    insert(buffer, 2, *[(CHAIR, 1)] * 500)
    assert len(buffer.table) <= len(buffer) == 45
    held(buffer)


def test_nothing_is_survived() -> None:
    buffer = SemanticBuffer(50, 0.5)
    assert insert(buffer, 0) == 0
    assert insert(buffer, 1, (CHAIR, 0)) == 0
    assert len(buffer) == len(buffer.table) == 0
    assert held(buffer) == {}
    labels, levels = buffer.counts()
    assert labels.tolist() == []
    assert levels.tolist() == [0, 0, 0]


def test_memory_is_flat_over_a_long_stream() -> None:
    """At worst every ray is the last one of its region, and more it cannot become."""
    capacity = 150
    buffer = SemanticBuffer(capacity, 0.5)
    random = stream(0, "test stream")
    sizes = []
    for number in range(600):
        labels = random.integers(0, 6, 4).tolist()
        insert(buffer, number, *(((label, label % 3), 20) for label in labels))
        assert len(buffer.table) <= len(buffer) <= capacity
        sizes.append(sum(array.nbytes for array in buffer.state().values()))
    # A table that forgot nothing would have grown to 2400 embeddings.
    assert max(sizes) < capacity * (2 * EMBEDDING_WIDTH + 50)
    assert max(sizes[400:]) <= 1.02 * max(sizes[200:400])


@settings(max_examples=30, deadline=None)
@given(
    keyframes=st.lists(
        st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2), st.integers(0, 30)), max_size=4),
        max_size=8,
    ),
    capacity=st.integers(20, 120),
)
def test_it_is_bounded_and_shares_out_by_a_water_level(
    keyframes: list[list[tuple[int, int, int]]], capacity: int
) -> None:
    buffer = SemanticBuffer(capacity, 0.5)
    before: dict[Pair, int] = {}
    for number, regions in enumerate(keyframes):
        offered = dict(before)
        for label, level, count in regions:
            offered[label, level] = offered.get((label, level), 0) + count
        evicted = insert(buffer, number, *(((a, b), n) for a, b, n in regions))
        now = held(buffer)
        assert (evicted > 0) == (sum(offered.values()) > capacity)
        assert len(buffer) == sum(offered.values()) - evicted <= capacity
        highest = max(now.values(), default=0)
        expected = {pair: min(count, highest) for pair, count in offered.items()}
        assert now == {pair: count for pair, count in expected.items() if count}
        labels, levels = buffer.counts()
        for label, count in enumerate(labels):
            assert count == sum(n for pair, n in now.items() if pair[0] == label)
        assert levels.tolist() == [sum(n for p, n in now.items() if p[1] == k) for k in range(3)]
        before = now


# Drawing.

COUNTS = {(0, 0): 900, (1, 2): 90, (4, 1): 9, (7, 0): 1}


def draws(balance: float, count: int, seed: int = 0) -> tuple[SemanticBuffer, np.ndarray]:
    buffer = SemanticBuffer(2000, balance)
    # In parts and mixed, so that the rows of a pair do not lie together.
    insert(buffer, 0, *((pair, n - n // 3) for pair, n in COUNTS.items()))
    insert(buffer, 1, *((pair, n // 3) for pair, n in reversed(COUNTS.items())))
    assert held(buffer) == COUNTS
    return buffer, buffer.draw(count, stream(seed, "draw"))


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_pairs_are_drawn_by_their_count_to_the_power_of_balance(balance: float) -> None:
    count = 40_000
    buffer, rows = draws(balance, count)
    assert rows.dtype == np.int64
    assert (rows >= 0).all()
    assert (rows < len(buffer)).all()
    total = sum(n**balance for n in COUNTS.values())
    of = buffer.table.take(buffer.take(rows).regions)
    for (label, level), n in COUNTS.items():
        share = n**balance / total
        found = ((of.labels == label) & (of.levels == level)).sum()
        assert abs(found - share * count) < 5 * np.sqrt(count * share) + 1
        # Within a pair every ray alike; the rarest pairs are seen whole.
        of_pair = rows[(of.labels == label) & (of.levels == level)]
        seen, times = np.unique(of_pair, return_counts=True)
        if share * count > 20 * n:
            assert len(seen) == n
            each = share * count / n
            assert np.abs(times - each).max() < 5 * np.sqrt(each)


def test_the_weights_of_the_extremes_are_exact() -> None:
    """With numbers that are spread evenly instead of drawn."""

    class Evenly(np.random.Generator):
        def __init__(self) -> None:
            super().__init__(np.random.Philox(0))

        def random(self, size: int) -> np.ndarray:  # type: ignore[override]
            return (np.arange(size) + 0.5) / size

    buffer, _ = draws(1.0, 1)
    rows = buffer.draw(1000, Evenly())
    of = buffer.table.take(buffer.take(rows).regions)
    assert np.bincount(of.labels)[[0, 1, 4, 7]].tolist() == [900, 90, 9, 1]
    buffer, _ = draws(0.0, 1)
    rows = buffer.draw(1000, Evenly())
    of = buffer.table.take(buffer.take(rows).regions)
    assert np.bincount(of.labels)[[0, 1, 4, 7]].tolist() == [250] * 4


def test_drawing_depends_on_what_is_held_and_the_stream_alone() -> None:
    buffer, rows = draws(0.5, 200)
    np.testing.assert_array_equal(buffer.draw(200, stream(0, "draw")), rows)
    assert not np.array_equal(draws(0.5, 200, seed=1)[1], rows)
    single = SemanticBuffer(10, 0.5)
    insert(single, 0, (CHAIR, 1))
    assert (single.draw(50, stream(0, "draw")) == 0).all()


def test_it_does_the_same_twice_and_after_a_restore() -> None:
    def fill(buffer: SemanticBuffer, numbers: range) -> SemanticBuffer:
        for number in numbers:
            insert(buffer, number, ((number % 5, number % 3), 40), (CHAIR, 20))
        return buffer

    first = fill(SemanticBuffer(200, 0.5), range(12))
    again = SemanticBuffer(200, 0.5)
    saved = fill(SemanticBuffer(200, 0.5), range(5)).state()
    again.restore({name: array.copy() for name, array in saved.items()})
    second = fill(again, range(5, 12))
    ours, theirs = first.state(), second.state()
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        np.testing.assert_array_equal(array, theirs[name])
        assert array.dtype == theirs[name].dtype
    np.testing.assert_array_equal(
        first.draw(100, stream(3, "draw")), second.draw(100, stream(3, "draw"))
    )


def test_a_table_takes_the_best_prompt_of_each_region() -> None:
    relevance = np.array([[0.1, 0.9, 0.3], [0.5, 0.2, 0.4]], np.float32)
    regions = Regions(
        boxes=np.zeros((2, 4), np.float32),
        levels=np.array([2, 1], np.uint8),
        relevance=relevance,
        embeddings=np.ones((2, EMBEDDING_WIDTH), np.float16),
        owner=np.zeros((3, 4), np.uint16),
        is_box=np.zeros(2, bool),
    )
    table = RegionTable.of(regions)
    assert table.labels.tolist() == [1, 0]
    np.testing.assert_array_equal(table.confidence, relevance[[0, 1], [1, 0]])
    assert table.levels.tolist() == [2, 1]
    dtypes = [array.dtype for array in vars(table).values()]
    assert dtypes == [array.dtype for array in vars(RegionTable.empty()).values()]


def test_regions_are_bounded_and_rare_ones_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(semantic_buffer, "MOST_REGIONS", 40)
    buffer = SemanticBuffer(10_000, 0.5)
    for keyframe in range(60):
        # Five regions of a crowd in every keyframe; a rare thing in the third one alone.
        labels = np.array([0] * 5 + [1] * (keyframe == 2), np.int32)
        count = len(labels)
        table = RegionTable(
            np.full((count, 512), keyframe, np.float16),
            np.full(count, 0.8, np.float32),
            np.zeros(count, np.uint8),
            labels,
        )
        regions = np.repeat(np.arange(count, dtype=np.int32), 3)
        vectors = np.ones((len(regions), 3), np.float32)
        rays = SemanticRays(vectors, vectors, np.ones(len(regions), np.float32), regions)
        buffer.insert(rays, table, stream(0, "buffer", keyframe))
        assert len(buffer.table) <= 40
    assert (buffer.table.labels == 1).sum() == 1
    assert len(np.unique(buffer.table.embeddings[:, 0])) > 20
