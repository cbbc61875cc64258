"""The replay buffer: bounded, fair to old places, deterministic."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.mapping.neural.replay_buffer import RaySamples, ReplayBuffer
from proground_log.streams import stream

PLACE_M = 0.25


def samples_at(center_m: tuple[float, float, float], count: int, seed: int) -> RaySamples:
    """Samples whose surface points lie in the one cell around `center_m`."""
    random = stream(seed, "test samples")
    offsets = random.uniform(-0.1, 0.1, (count, 3)).astype(np.float32)
    points_m = np.array(center_m, np.float32) + offsets
    return RaySamples(
        origins_m=np.zeros((count, 3), np.float32),
        directions=points_m,
        depth_m=np.ones(count, np.float32),
        colors=random.integers(0, 256, (count, 3), dtype=np.uint8),
    )


HERE, THERE = (0.125, 0.125, 0.125), (5.125, 0.125, 0.125)


def insert(buffer: ReplayBuffer, keyframe: int, rays: RaySamples) -> int:
    return buffer.insert(keyframe, rays, stream(0, "buffer", keyframe))


def test_everything_stays_while_it_fits() -> None:
    buffer = ReplayBuffer(100, PLACE_M)
    first, second = samples_at(HERE, 40, 1), samples_at(THERE, 50, 2)
    assert insert(buffer, 0, first) == 0
    assert insert(buffer, 1, second) == 0
    kept = buffer.take(np.arange(90))
    np.testing.assert_array_equal(kept.colors, np.concatenate([first.colors, second.colors]))
    np.testing.assert_array_equal(kept.depth_m, np.ones(90))
    assert buffer.statistics().keyframes == 2
    assert buffer.statistics().places == 2


def test_an_old_place_keeps_its_samples_while_the_camera_stares_at_another() -> None:
    buffer = ReplayBuffer(300, PLACE_M)
    old = samples_at(HERE, 60, 0)
    insert(buffer, 0, old)
    for keyframe in range(1, 200):
        insert(buffer, keyframe, samples_at(THERE, 50, keyframe))
        assert len(buffer) <= 300
    kept = buffer.take(np.arange(len(buffer)))
    at_old_place = kept.points_m()[:, 0] < 1
    np.testing.assert_array_equal(kept.colors[at_old_place], old.colors)
    # An eviction leaves 270 samples, and one keyframe of 50 may have come on top since.
    assert 270 - 60 <= (~at_old_place).sum() <= 240


def test_within_a_place_old_and_new_samples_have_the_same_chance() -> None:
    buffer = ReplayBuffer(400, PLACE_M)
    for keyframe in range(40):
        insert(buffer, keyframe, samples_at(HERE, 100, keyframe))
    keyframes = buffer.state()["keyframes"]
    # 10 of each keyframe's 100 are expected to be left; a purge by age would leave 0 or 100.
    assert (np.bincount(keyframes, minlength=40) > 0).all()
    assert np.bincount(keyframes).max() < 30
    assert 130 < (keyframes < 20).sum() < 250


@settings(max_examples=30, deadline=None)
@given(
    sizes=st.lists(st.tuples(st.integers(1, 60), st.integers(0, 5)), min_size=1, max_size=12),
    capacity=st.integers(10, 150),
)
def test_it_is_bounded_and_shares_out_by_a_water_level(
    sizes: list[tuple[int, int]], capacity: int
) -> None:
    buffer = ReplayBuffer(capacity, PLACE_M)
    held = np.zeros(6, int)
    for keyframe, (count, place) in enumerate(sizes):
        center = (place + 0.125, 0.125, 0.125)
        evicted = insert(buffer, keyframe, samples_at(center, count, keyframe))
        held[place] += count
        assert (evicted > 0) == (held.sum() > capacity)
        points_m = buffer.take(np.arange(len(buffer))).points_m()
        now_held = np.bincount(np.floor(points_m[:, 0]).astype(int), minlength=6)
        assert len(buffer) == held.sum() - evicted <= capacity
        # Every place keeps what it has, up to one level for all.
        np.testing.assert_array_equal(now_held, np.minimum(held, now_held.max()))
        held = now_held


def test_it_does_the_same_twice_and_after_a_restore() -> None:
    def fill(buffer: ReplayBuffer, keyframes: range) -> ReplayBuffer:
        for keyframe in keyframes:
            place = HERE if keyframe % 3 else THERE
            insert(buffer, keyframe, samples_at(place, 70, keyframe))
        return buffer

    first = fill(ReplayBuffer(200, PLACE_M), range(12)).state()
    again = ReplayBuffer(200, PLACE_M)
    again.restore(fill(ReplayBuffer(200, PLACE_M), range(5)).state())
    second = fill(again, range(5, 12)).state()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name])
        assert array.dtype == second[name].dtype
