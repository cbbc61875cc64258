"""The simulated schedule: by hand, and against what must hold for any schedule."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.run.settings import Overrun
from replay.scheduler import Drop, Policy, RegionsReady, Slot, Timing, schedule

TIMING = Timing(decode_ns=2, perceive_ns=0, insert_ns=3, step_ns=10)
REAL_TIME = Policy(budget_ns=30, steps=0, lock_step=False, queue=1, overrun="drop-oldest")
LOCK_STEP = Policy(budget_ns=None, steps=4, lock_step=True, queue=1, overrun="wait")


def run(
    arrivals_ns: list[int], policy: Policy, timing: Timing = TIMING
) -> tuple[list[Slot], list[Drop | RegionsReady]]:
    """Frames are numbered by tens, so that numbers and positions are not taken for each other."""
    frames = [10 * n for n in range(len(arrivals_ns))]
    slots = list(schedule(frames, arrivals_ns, timing, policy))
    return slots, [event for slot in slots for event in slot.meanwhile]


def test_steps_fill_the_budget_after_reading_and_inserting() -> None:
    slots, _ = run([0, 100], REAL_TIME)
    assert [(s.begin_ns, s.end_ns, s.steps, s.overrun_ns) for s in slots] == [
        (0, 25, 2, 0),
        (100, 125, 2, 0),
    ]


def test_a_budget_too_small_gives_no_step_and_counts_what_is_too_much() -> None:
    slots, _ = run([0, 100], replace(REAL_TIME, budget_ns=4))
    assert [(s.end_ns - s.begin_ns, s.steps, s.overrun_ns) for s in slots] == [(5, 0, 1), (5, 0, 1)]


@pytest.mark.parametrize(
    ("overrun", "mapped", "dropped"),
    [
        ("drop-oldest", [0, 30, 40], [(10, 12), (20, 13)]),
        ("drop-newest", [0, 10, 40], [(20, 12), (30, 13)]),
        ("wait", [0, 10, 20, 30, 40], []),
    ],
)
def test_what_gives_when_the_queue_is_full(
    overrun: Overrun, mapped: list[int], dropped: list[tuple[int, int]]
) -> None:
    """The first frame takes 25 ns; three more come meanwhile, one at a time that is free again."""
    slots, events = run([0, 11, 12, 13, 60], replace(REAL_TIME, overrun=overrun))
    assert [slot.frame for slot in slots] == mapped
    assert [(event.frame, event.at_ns) for event in events] == dropped
    assert all(isinstance(event, Drop) and overrun in event.reason for event in events)


def test_work_ends_before_a_frame_arrives_at_the_same_moment() -> None:
    slots, events = run([0, 1, 25], REAL_TIME)
    assert [slot.frame for slot in slots] == [0, 10, 20]
    assert events == []


def test_lock_step_knows_no_arrivals() -> None:
    slots, events = run([0, 0, 0], LOCK_STEP)
    assert [(s.arrived_ns, s.begin_ns, s.end_ns, s.steps) for s in slots] == [
        (0, 0, 45, 4),
        (45, 45, 90, 4),
        (90, 90, 135, 4),
    ]
    assert events == []


def test_keyframes_and_perception_every_so_many_mapped_frames() -> None:
    timing = replace(TIMING, perceive_ns=7)
    policy = replace(LOCK_STEP, keyframe_every=2, perceive_every=3)
    slots, _ = run([0] * 7, policy, timing)
    assert [s.is_keyframe for s in slots] == [True, False] * 3 + [True]
    assert [s.is_perceived for s in slots] == [n % 3 == 0 for n in range(7)]
    assert [s.end_ns - s.begin_ns for s in slots] == [52 if n % 3 == 0 else 45 for n in range(7)]
    slots, _ = run([0] * 7, replace(policy, keyframes_only=True), timing)
    assert [s.is_perceived for s in slots] == [n % 6 == 0 for n in range(7)]


def test_perception_beside_costs_the_mapper_nothing_and_takes_the_newest() -> None:
    """Asked at 2, 47, 92, 137, 182; it takes 100: one runs, the newest waits, others never come."""
    timing = replace(TIMING, perceive_ns=100)
    slots, events = run([0] * 7, replace(LOCK_STEP, beside=True), timing)
    assert all(slot.end_ns - slot.begin_ns == 45 for slot in slots)
    assert events == [
        RegionsReady(0, 2, 102),
        RegionsReady(20, 102, 202),
        RegionsReady(40, 202, 302),
    ]
    for before, slot in zip([None, *slots], slots, strict=False):
        begin_ns = before.end_ns if before else -1
        assert all(begin_ns < event.at_ns <= slot.end_ns for event in slot.meanwhile)


nanoseconds = st.integers(0, 50)


@settings(max_examples=400, deadline=None)
@given(
    gaps=st.lists(nanoseconds, max_size=40),
    timing=st.builds(
        Timing,
        decode_ns=nanoseconds,
        perceive_ns=st.integers(0, 200),
        insert_ns=nanoseconds,
        step_ns=st.integers(1, 50),
        learn_ns=nanoseconds,
    ),
    policy=st.builds(
        Policy,
        budget_ns=st.none() | st.integers(1, 200),
        steps=st.integers(0, 6),
        lock_step=st.booleans(),
        queue=st.integers(1, 4),
        overrun=st.sampled_from(get_args(Overrun)),
        keyframe_every=st.integers(1, 3),
        perceive_every=st.integers(1, 3),
        keyframes_only=st.booleans(),
        beside=st.booleans(),
    ),
)
def test_what_holds_for_every_schedule(gaps: list[int], timing: Timing, policy: Policy) -> None:
    arrivals_ns = [sum(gaps[: n + 1]) for n in range(len(gaps))]
    slots, events = run(arrivals_ns, policy, timing)
    drops = [event for event in events if isinstance(event, Drop)]
    # No frame is lost without an event, none comes twice, and those mapped keep their order.
    mapped = [slot.frame for slot in slots]
    assert sorted(mapped + [drop.frame for drop in drops]) == [10 * n for n in range(len(gaps))]
    assert mapped == sorted(mapped)
    if policy.lock_step or policy.overrun == "wait":
        assert not drops
    # Time never runs back, and what is spent and idle is what has elapsed.
    spent = idle = now_ns = 0
    for slot in slots:
        assert slot.arrived_ns <= slot.begin_ns <= slot.end_ns
        assert slot.begin_ns >= now_ns
        assert [event.at_ns for event in slot.meanwhile] == sorted(
            event.at_ns for event in slot.meanwhile
        )
        if not policy.lock_step:
            # Idle only while nobody waits.
            assert slot.begin_ns in (now_ns, slot.arrived_ns)
        spent, idle = spent + slot.end_ns - slot.begin_ns, idle + slot.begin_ns - now_ns
        now_ns = slot.end_ns
        assert 0 <= slot.waiting < policy.queue
        inline = slot.is_perceived and not policy.beside
        ingest_ns = timing.decode_ns + timing.insert_ns + timing.perceive_ns * inline
        ingest_ns += timing.learn_ns * slot.is_perceived
        assert slot.end_ns - slot.begin_ns == ingest_ns + slot.steps * timing.step_ns
        if policy.budget_ns is None:
            assert slot.steps == policy.steps
        else:
            spare_ns = policy.budget_ns - (slot.end_ns - slot.begin_ns)
            assert spare_ns < timing.step_ns
            assert slot.overrun_ns == max(0, -spare_ns)
            assert slot.overrun_ns == 0 or slot.steps == 0
    assert spent + idle == now_ns
    # The queue never passes its bound: of those that came and were neither taken nor dropped.
    if not policy.lock_step and policy.overrun != "wait":
        begins = {slot.frame: slot.begin_ns for slot in slots}
        leaves = begins | {drop.frame: drop.at_ns for drop in drops}
        for slot in slots:
            inside = slot.end_ns - 1
            came = [10 * n for n, at_ns in enumerate(arrivals_ns) if at_ns <= inside]
            assert sum(leaves[frame] > inside for frame in came) <= policy.queue
    # Perception beside works on one frame at a time, in order, after it was asked.
    ready = [event for event in events if isinstance(event, RegionsReady)]
    asked = {slot.frame: slot.begin_ns + timing.decode_ns for slot in slots if slot.is_perceived}
    assert [event.frame for event in ready] == sorted({event.frame for event in ready})
    for event in ready:
        assert event.begin_ns >= asked[event.frame]
        assert event.at_ns - event.begin_ns == timing.perceive_ns
    for first, second in pairwise(ready):
        assert second.begin_ns >= first.at_ns
