"""Where two states of settings or code part ways: the first step, and the tensors that differ.

Both runs are made again from the newest checkpoint at which they were still equal, with the state
digested after every step, and once more up to the first step after which it differs, whose states
are compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Protocol

from proground_log.errors import ProgroundError
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.ledger import read_ledger
from replay.divergence.diff import require_common
from replay.divergence.distance import TensorDifference, tensor_differences
from replay.divergence.divergence import Divergence, Entry, first_divergence, with_last_step
from replay.divergence.rerun import Excerpt

CHECKPOINTS = 8
"""Kept in a re-run: the way to the step is so much shorter the second time."""


class Side(Protocol):
    """One of the two: makes its run again, with its own settings and its own code."""

    @property
    def run(self) -> RunFolder: ...

    def rerun(self, output: Path, excerpt: Excerpt) -> None:
        """As `replay.divergence.rerun.rerun`."""
        ...

    def state_after(self, output: Path, frame: int, iteration: int, start: Path | None) -> None:
        """As `replay.divergence.rerun.state_after`."""
        ...


@dataclass(frozen=True)
class Bisection:
    """Where two runs part ways.

    Args:
        frames_equal: frames read up to the newest checkpoint of both that is the same; 0: none is.
        divergence: the first difference of the ledgers of the re-runs.
        frame, iteration, step: the first step after which the state differs, its number in the
            frame and in the run; None where the runs did not get to do the same steps.
        tensors: the tensors of the state that differ after it.
    """

    frames_equal: int
    divergence: Divergence
    frame: int | None
    iteration: int | None
    step: int | None
    tensors: dict[str, TensorDifference]


def bisect(first: Side, second: Side, output: Path) -> Bisection | None:
    """Narrow a divergence of two finished runs down.

    Args:
        first, second: the runs.
        output: folder for the re-runs and the two states: first/, second/, first.safetensors,
            second.safetensors.

    Returns:
        What was found; None where the runs' ledgers are equal.

    Raises:
        ProgroundError: the runs have nothing in common, or the re-runs do not differ.
    """
    a, b = first.run.require_finished(), second.run.require_finished()
    if output.exists():
        raise ProgroundError("the output exists", where=output, todo="choose another name")
    divergence, _ = first_divergence(read_ledger(a.ledger), read_ledger(b.ledger))
    if divergence is None:
        return None
    require_common(a, b)
    turns = _turns_before(a, divergence)
    frames_equal, starts = newest_equal_checkpoint(a, b, turns)
    again = RunFolder(output / "first"), RunFolder(output / "second")
    keep_every = max(1, (turns - frames_equal) // CHECKPOINTS)
    for side, start, run in zip((first, second), starts, again, strict=True):
        side.rerun(run.path, Excerpt(start, divergence.frame or 0, keep_every))
    closer, _ = first_divergence(_entries(again[0]), _entries(again[1]))
    if closer is None:
        raise ProgroundError(
            "the difference does not show again when both runs are repeated here",
            where=f"{a.path} and {b.path}",
            todo="see with `pglog diff` whether machine, packages or code were others",
        )
    step = None if closer.cause == "schedule" else _first_step_that_differs(*again)
    if step is None:
        return Bisection(frames_equal, closer, None, None, None, {})
    frame, iteration = step["frame"], step["iteration"]
    nearer, near_starts = newest_equal_checkpoint(*again, _turns_before(again[0], closer))
    if nearer > frames_equal:
        frames_equal, starts = nearer, near_starts
    states = [output / f"{run.path.name}.safetensors" for run in again]
    for side, start, state in zip((first, second), starts, states, strict=True):
        side.state_after(state, frame, iteration, start)
    x, y = (Checkpoint.read(state).state for state in states)
    tensors = tensor_differences(x, y)
    return Bisection(frames_equal, closer, frame, iteration, step["step"], tensors)


def newest_equal_checkpoint(
    a: RunFolder, b: RunFolder, most_turns: int
) -> tuple[int, tuple[Path | None, Path | None]]:
    """The newest checkpoint that both runs kept and that is the same in both.

    Args:
        a, b: the runs.
        most_turns: look at none after so many frames.

    Returns:
        The number of frames read up to there, and the two files; 0 and no files where there is
        none.
    """
    kept = a.kept_checkpoints(), b.kept_checkpoints()
    common = sorted(number for number in kept[0].keys() & kept[1].keys() if number <= most_turns)
    for number in reversed(common):
        paths = kept[0][number], kept[1][number]
        x, y = (Checkpoint.read(path) for path in paths)
        if x.steps == y.steps and not tensor_differences(x.state, y.state):
            return number, paths
    return 0, (None, None)


def _entries(run: RunFolder) -> Iterator[Entry]:
    """The ledger of a run that may have been stopped."""
    return read_ledger(run.ledger if run.ledger.is_file() else run.partial_ledger)


def _turns_before(run: RunFolder, divergence: Divergence) -> int:
    """Frames read before the one in which a ledger differs."""
    lines = islice(_entries(run), divergence.line)
    return max(0, sum(entry["event"] == "frame" for entry in lines) - 1)


def _first_step_that_differs(a: RunFolder, b: RunFolder) -> Entry | None:
    """The first step after which both runs' states are told, and differ."""
    digests = {e["step"]: e["digests"] for e in _entries(b) if e["event"] == "state"}
    for entry, step in with_last_step(_entries(a)):
        if entry["event"] != "state":
            continue
        if digests.get(entry["step"], entry["digests"]) != entry["digests"]:
            return step
    return None
