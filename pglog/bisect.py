"""The command that narrows a divergence down: bisect."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pglog.common import DIFFERENT, SAME, AsJson, Output, Run
from pglog.diff import print_divergence
from pglog.rerun import perceiver_of_run
from proground_log.perception.opening import PerceptionOptions

if TYPE_CHECKING:
    from replay.divergence.bisect import Bisection, Side


def bisect_command(
    first: Run,
    second: Run,
    *,
    output: Output,
    code_a: Path | None = None,
    code_b: Path | None = None,
    log: Path | None = None,
    perception: Annotated[PerceptionOptions, tyro.conf.arg(name="")] = PerceptionOptions(),
    threads: int | None = None,
    as_json: AsJson = False,
) -> int:
    """Find the first step after which two runs' states differ, and in which tensors.

    Both runs are made again from the newest checkpoint that both have kept and that is the same in
    both (`pglog replay --keep-checkpoints`), or else from the beginning. Exit code 1 if they
    differ.

    Args:
        first: folder of a run.
        second: folder of another.
        output: folder for the re-runs.
        code_a: checkout of proground-log that made the first; by default this one.
        code_b: checkout that made the second.
        log: the runs' log, where it has moved.
        perception: how regions are found, where the runs found them themselves.
        threads: compute on so many; the result is the same for any number.
        as_json: print JSON, for programs.
    """
    from proground_log.run.folder import RunFolder
    from replay.device import set_threads
    from replay.divergence.bisect import bisect
    from replay.divergence.diff import origins_of
    from replay.divergence.sides import ThisCode, other_code

    set_threads(threads)
    sides: list[Side] = []
    for run, code in ((first, code_a), (second, code_b)):
        folder = RunFolder(run).require_finished()
        if code is not None:
            sides.append(other_code(folder, code, log=log, threads=threads, perception=perception))
        else:
            sides.append(ThisCode(folder, log, perceiver_of_run(run, log, perception)))
    result = bisect(sides[0], sides[1], output)
    if as_json:
        found = None if result is None else dataclasses.asdict(result)
        print(json.dumps({"same": result is None, "found": found}, indent=2))
    elif result is None:
        print("the runs' ledgers are equal")
    else:
        _print(result, origins_of(RunFolder(first), RunFolder(second)))
    return SAME if result is None else DIFFERENT


def _print(result: Bisection, origins: list[str]) -> None:
    for origin in origins:
        print(origin)
    if result.frames_equal:
        print(f"after {result.frames_equal} frames both states are equal")
    print_divergence(result.divergence, origins)
    if result.step is not None:
        print(
            f"first state that differs: after step {result.step} "
            f"(frame {result.frame}, its step {result.iteration})"
        )
    for name, difference in result.tensors.items():
        print(f"  {name}: {difference}")
