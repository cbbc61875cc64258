"""Where the runs of a bisection are made again: by this code, or by another checkout's."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.perception.opening import PerceptionOptions
from proground_log.perception.perceiver import Perceiver
from proground_log.run.folder import RunFolder
from replay.divergence.rerun import Excerpt, rerun, state_after

BEFORE_0_2 = "proground_log.cli"
"""Where the command was in checkouts of version 0.1."""


@dataclass(frozen=True)
class ThisCode:
    """A run to be made again by this process."""

    run: RunFolder
    log: Path | None
    perceiver: Perceiver | None

    def rerun(self, output: Path, excerpt: Excerpt) -> None:
        rerun(self.run.path, output, log=self.log, perceiver=self.perceiver, excerpt=excerpt)

    def state_after(self, output: Path, frame: int, iteration: int, start: Path | None) -> None:
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
class OtherCode:
    """A run to be made again by the `pglog` of a checkout."""

    run: RunFolder
    code: Path
    flags: list[str]

    def rerun(self, output: Path, excerpt: Excerpt) -> None:
        options = {
            "start": excerpt.start,
            "until_frame": excerpt.until_frame,
            "keep_every": excerpt.keep_every,
        }
        self._pglog_rerun(output, options)

    def state_after(self, output: Path, frame: int, iteration: int, start: Path | None) -> None:
        options = {"start": start, "until_frame": frame, "until_step": iteration}
        self._pglog_rerun(output, options)

    def _pglog_rerun(self, output: Path, options: Mapping[str, object]) -> None:
        # -P: the folder that the user is in is no place to find code.
        module = "pglog" if (self.code / "pglog").is_dir() else BEFORE_0_2
        command = [sys.executable, "-P", "-m", module, "rerun", str(self.run.path)]
        done = subprocess.run(
            [*command, "-o", str(output), *_flags(options), *self.flags],
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


def other_code(
    run: RunFolder,
    code: Path,
    *,
    log: Path | None,
    threads: int | None,
    perception: PerceptionOptions,
) -> OtherCode:
    """A run to be made again by a checkout, with these options of `pglog rerun`.

    Raises:
        ProgroundError: the folder is no checkout of proground-log.
    """
    if not any((code / folder).is_dir() for folder in ("pglog", BEFORE_0_2.replace(".", "/"))):
        raise ProgroundError(
            "is no checkout of proground-log", where=code, todo="give the folder of its README"
        )
    given = {"log": log, "threads": threads, **vars(perception)}
    return OtherCode(run, code, _flags(given))


def _flags(options: Mapping[str, object]) -> list[str]:
    """The options that are given, as they are written on a command line."""
    flags: list[str] = []
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        if value is True:
            flags.append(option)
        elif value is not None and value is not False:
            flags += [option, str(value)]
    return flags
