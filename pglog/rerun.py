"""The command that makes a run again: rerun."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pglog.common import (
    DIFFERENT,
    SAME,
    STOPPED,
    Output,
    Run,
    frames_watched,
)
from pglog.diff import print_divergence
from proground_log.errors import ProgroundError
from proground_log.perception.opening import PerceptionOptions, perceiver_of_replay

if TYPE_CHECKING:
    from proground_log.perception.perceiver import Perceiver


def rerun_command(
    run: Run,
    *,
    output: Output,
    check: bool = False,
    log: Path | None = None,
    perception: Annotated[PerceptionOptions, tyro.conf.arg(name="")] = PerceptionOptions(),
    threads: int | None = None,
    start: Path | None = None,
    until_frame: int | None = None,
    until_step: int | None = None,
    keep_every: int | None = None,
    overwrite: bool = False,
) -> int:
    """Make a run again from its manifest: the same log, settings and cost model.

    Args:
        run: folder of the run, or its manifest.json.
        output: folder of the new run.
        check: compare with the run's ledger meanwhile; at the first difference stop, name it, and
            give exit code 1.
        log: the run's log, where it has moved.
        perception: how regions are found, where the run found them itself.
        threads: compute on so many; the result is the same for any number.
        start: begin at a kept checkpoint of the run.
        until_frame: stop after this frame of the log.
        until_step: stop after this step of it, from 0; the output is the state there
            (.safetensors).
        keep_every: digest the state after every step, keep a checkpoint every so many frames, and
            leave telemetry out.
        overwrite: replace a run that is in the output.
    """
    from proground_log.run.folder import RunFolder
    from replay.device import set_threads
    from replay.divergence.diff import origins_of
    from replay.divergence.rerun import Excerpt, rerun, state_after
    from replay.session import ReplayStoppedError

    set_threads(threads)
    perceiver = perceiver_of_run(run, log, perception)
    if until_step is not None:
        if until_frame is None or check or keep_every is not None:
            raise ProgroundError(
                "--until-step goes with --until-frame, and with neither --check nor --keep-every",
                where="rerun",
                todo="say of which frame it is a step",
            )
        state_after(
            run,
            output,
            frame=until_frame,
            iteration=until_step,
            start=start,
            log=log,
            perceiver=perceiver,
        )
        return SAME
    try:
        divergence = rerun(
            run,
            output,
            check=check,
            log=log,
            perceiver=perceiver,
            watchers=frames_watched,
            excerpt=Excerpt(start, until_frame, keep_every),
            overwrite=overwrite,
        )
    except ReplayStoppedError as stop:
        print(f"pglog: {stop}", file=sys.stderr)
        return STOPPED
    if divergence is None:
        print("the run repeats itself, bit for bit" if check else f"{output}: made again")
        return SAME
    origins = origins_of(RunFolder(run if run.is_dir() else run.parent), RunFolder(output))
    for origin in origins:
        print(origin)
    print_divergence(divergence, origins)
    return DIFFERENT


def perceiver_of_run(run: Path, log: Path | None, options: PerceptionOptions) -> Perceiver | None:
    """The perceiver that the options name for the log of a run; None where none are given."""
    from proground_log.run.opened import OpenedRun

    return perceiver_of_replay(OpenedRun(run, log).log, options) if options.is_given else None
