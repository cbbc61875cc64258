"""The command that narrows a divergence down: bisect."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pglog.common import DIFFERENT, SAME, AsJson, Output, Run
from pglog.diff import print_divergence
from pglog.rerun import perceiver_of_run
from proground_log.errors import ProgroundError
from proground_log.perception.opening import PerceptionOptions

if TYPE_CHECKING:
    from proground_log.perception.perceiver import Perceiver
    from proground_log.run.folder import RunFolder
    from replay.divergence.bisect import Bisection, Side
    from replay.divergence.rerun import Excerpt


BEFORE_0_2 = "proground_log.cli"
"""Where the command was in checkouts of version 0.1."""


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

    set_threads(threads)
    flags = [*_flags(log, threads), *_perception_flags(perception)]
    sides: list[Side] = []
    for run, code in ((first, code_a), (second, code_b)):
        folder = RunFolder(run).require_finished()
        if code is not None:
            sides.append(_OtherCode(folder, _require_checkout(code), flags))
        else:
            sides.append(_ThisCode(folder, log, perceiver_of_run(run, log, perception)))
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


@dataclass(frozen=True)
class _ThisCode:
    """A run to be made again by this process."""

    run: RunFolder
    log: Path | None
    perceiver: Perceiver | None

    def rerun(self, output: Path, excerpt: Excerpt) -> None:
        from replay.divergence.rerun import rerun

        rerun(self.run.path, output, log=self.log, perceiver=self.perceiver, excerpt=excerpt)

    def state_after(self, output: Path, frame: int, iteration: int, start: Path | None) -> None:
        from replay.divergence.rerun import state_after

        state_after(
            self.run.path,
            output,
            frame=frame,
            iteration=iteration,
            start=start,
            log=self.log,
            perceiver=self.perceiver,
        )


@dataclass(frozen=True)
class _OtherCode:
    """A run to be made again by the `pglog` of a checkout."""

    run: RunFolder
    code: Path
    flags: list[str]

    def rerun(self, output: Path, excerpt: Excerpt) -> None:
        options = {
            "start": excerpt.start,
            "until-frame": excerpt.until_frame,
            "keep-every": excerpt.keep_every,
        }
        self._pglog_rerun(output, options)

    def state_after(self, output: Path, frame: int, iteration: int, start: Path | None) -> None:
        options = {"start": start, "until-frame": frame, "until-step": iteration}
        self._pglog_rerun(output, options)

    def _pglog_rerun(self, output: Path, options: Mapping[str, object]) -> None:
        given = [
            word
            for name, value in options.items()
            if value is not None
            for word in (f"--{name}", str(value))
        ]
        # -P: the folder that the user is in is no place to find code.
        module = "pglog" if (self.code / "pglog").is_dir() else BEFORE_0_2
        command = [sys.executable, "-P", "-m", module, "rerun", str(self.run.path)]
        done = subprocess.run(
            [*command, "-o", str(output), *given, *self.flags],
            env={**os.environ, "PYTHONPATH": str(self.code.resolve())},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or ["it failed"])[-1]
            raise ProgroundError(
                f"its pglog rerun says: {reason}",
                where=self.code,
                todo=f"try `pglog rerun {self.run.path}` there",
            )


def _require_checkout(code: Path) -> Path:
    if not any((code / folder).is_dir() for folder in ("pglog", BEFORE_0_2.replace(".", "/"))):
        raise ProgroundError(
            "is no checkout of proground-log", where=code, todo="give the folder of its README"
        )
    return code


def _flags(log: Path | None, threads: int | None) -> list[str]:
    flags = [] if log is None else ["--log", str(log)]
    return flags if threads is None else [*flags, "--threads", str(threads)]


def _perception_flags(options: PerceptionOptions) -> list[str]:
    """The options as they are written on a command line."""
    flags: list[str] = []
    for name, value in vars(options).items():
        option = f"--{name.replace('_', '-')}"
        if value is True:
            flags.append(option)
        elif value not in (None, False):
            flags += [option, str(value)]
    return flags
