"""Simulated real time: which frames are mapped, when, and with how many steps.

A discrete-event simulation in integer nanoseconds of one computer that maps, and of a second one
where perception runs beside it. It knows no wall clock, no log and no mapper: what a replay does
under a budget follows from the arrival times and the cost model alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from proground_log.run.settings import Overrun


@dataclass(frozen=True)
class Timing:
    """What each stage takes, in nanoseconds.

    Args:
        decode_ns: to read and register a frame.
        perceive_ns: to find its regions; 0 where nothing is perceived.
        insert_ns: to put it into the mapper's memory.
        step_ns: one optimisation step; 0 where frames get none.
        learn_ns: to put its regions into memory, whenever they come; a perceived frame pays it.
    """

    decode_ns: int
    perceive_ns: int
    insert_ns: int
    step_ns: int
    learn_ns: int = 0


@dataclass(frozen=True)
class Policy:
    """How a computer that is too slow gives way.

    Args:
        budget_ns: what a mapped frame may take; None: every one gets `steps` steps.
        steps: optimisation steps of a frame where there is no budget.
        lock_step: whether the next frame arrives when the mapper is free.
        queue: frames that may wait, at least 1.
        overrun: what gives when one more arrives.
        keyframe_every: every so many mapped frames, one is a keyframe.
        perceive_every: every so many mapped frames, one is perceived.
        keyframes_only: of these, only keyframes.
        beside: whether perception has a computer of its own, and its result comes later.
    """

    budget_ns: int | None
    steps: int
    lock_step: bool
    queue: int
    overrun: Overrun
    keyframe_every: int = 1
    perceive_every: int = 1
    keyframes_only: bool = False
    beside: bool = False


class Drop(NamedTuple):
    """A frame that never reached the mapper."""

    frame: int
    at_ns: int
    reason: str


class RegionsReady(NamedTuple):
    """Perception beside the mapper has finished a frame that was mapped before."""

    frame: int
    begin_ns: int
    at_ns: int


class Slot(NamedTuple):
    """What a mapped frame gets.

    Args:
        frame: its number.
        arrived_ns, begin_ns, end_ns: when it arrived, and was mapped.
        waiting: frames that waited when it was taken, itself not counted.
        steps: optimisation steps.
        is_keyframe: whether it is one.
        is_perceived: whether its regions are found, in its own time or beside.
        overrun_ns: what reading, perceiving and inserting it took beyond the budget.
        meanwhile: what else happened up to its end, since the end of the slot before; by time.
    """

    frame: int
    arrived_ns: int
    begin_ns: int
    end_ns: int
    waiting: int
    steps: int
    is_keyframe: bool
    is_perceived: bool
    overrun_ns: int
    meanwhile: tuple[Drop | RegionsReady, ...]


def schedule(
    frames: Sequence[int], arrivals_ns: Sequence[int], timing: Timing, policy: Policy
) -> Iterator[Slot]:
    """Simulate a replay.

    Work finishes before a frame arrives at the same nanosecond, so that a queue has its place
    free again. A frame that waits is taken as soon as the mapper is done with the one before: a
    budget says what a frame may take at most, not when the next may begin.

    Args:
        frames: numbers of the frames.
        arrivals_ns: when each arrives, ascending; of no meaning in lock-step.
        timing: what each stage takes.
        policy: how frames are dropped, and steps given.

    Yields:
        The mapped frames in order; frames that are not among them are drops in some `meanwhile`.
    """
    waiting: deque[int] = deque()
    perception = _Perception(timing.perceive_ns) if policy.beside and timing.perceive_ns else None
    now_ns = following = 0
    for mapped in range(len(frames)):
        happened: list[Drop | RegionsReady] = []
        if waiting:
            taken = waiting.popleft()
        elif following < len(frames):
            taken = following
            following += 1
            if not policy.lock_step:
                now_ns = max(now_ns, arrivals_ns[taken])
        else:
            return
        arrived_ns = now_ns if policy.lock_step else arrivals_ns[taken]
        is_keyframe = mapped % policy.keyframe_every == 0
        is_perceived = (
            timing.perceive_ns > 0
            and mapped % policy.perceive_every == 0
            and (is_keyframe or not policy.keyframes_only)
        )
        ingest_ns = timing.decode_ns + timing.insert_ns + timing.learn_ns * is_perceived
        if is_perceived and perception is None:
            ingest_ns += timing.perceive_ns
        steps, overrun_ns = policy.steps if timing.step_ns else 0, 0
        if policy.budget_ns is not None:
            if timing.step_ns:
                steps = max(0, policy.budget_ns - ingest_ns) // timing.step_ns
            overrun_ns = max(0, ingest_ns - policy.budget_ns)
        begin_ns = now_ns
        now_ns += ingest_ns + steps * timing.step_ns
        queued = len(waiting)
        if not policy.lock_step:
            while following < len(frames) and arrivals_ns[following] < now_ns:
                if len(waiting) == policy.queue:
                    if policy.overrun == "wait":
                        break
                    leaves = following
                    if policy.overrun == "drop-oldest":
                        leaves = waiting.popleft()
                        waiting.append(following)
                    reason = f"{policy.overrun}: {policy.queue} waited already"
                    happened.append(Drop(frames[leaves], arrivals_ns[following], reason))
                else:
                    waiting.append(following)
                following += 1
        if perception is not None:
            if is_perceived:
                perception.ask(frames[taken], begin_ns + timing.decode_ns)
            happened += perception.done_by(now_ns)
            happened.sort(key=_moment)
        yield Slot(
            frames[taken],
            arrived_ns,
            begin_ns,
            now_ns,
            queued,
            steps,
            is_keyframe,
            is_perceived,
            overrun_ns,
            tuple(happened),
        )


def _moment(happening: Drop | RegionsReady) -> int:
    return happening.at_ns


class _Perception:
    """A computer that perceives one frame at a time; of those that wait it takes the newest.

    Args:
        cost_ns: what a frame takes.
    """

    def __init__(self, cost_ns: int) -> None:
        self._cost_ns = cost_ns
        self._free_ns = 0
        self._waiting: int | None = None
        self._results: deque[RegionsReady] = deque()

    def ask(self, frame: int, at_ns: int) -> None:
        """A frame is there to be perceived; one that waits already has waited in vain."""
        self._begin_waiting(at_ns)
        if self._free_ns <= at_ns:
            self._begin(frame, at_ns)
        else:
            self._waiting = frame

    def done_by(self, at_ns: int) -> list[RegionsReady]:
        """What is finished until then, and was not yet told."""
        self._begin_waiting(at_ns)
        done = []
        while self._results and self._results[0].at_ns <= at_ns:
            done.append(self._results.popleft())
        return done

    def _begin_waiting(self, at_ns: int) -> None:
        if self._waiting is not None and self._free_ns <= at_ns:
            self._begin(self._waiting, self._free_ns)
            self._waiting = None

    def _begin(self, frame: int, at_ns: int) -> None:
        self._free_ns = at_ns + self._cost_ns
        self._results.append(RegionsReady(frame, at_ns, self._free_ns))
