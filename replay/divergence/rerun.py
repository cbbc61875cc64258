"""A run made again from its manifest: all of it, or a part of it looked at closely."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from proground_log.errors import ProgroundError
from proground_log.events import Sink
from proground_log.files import disk_errors, require_file, require_free
from proground_log.perception.description import PerceptionDescription, fingerprint
from proground_log.perception.of_log import perception_of
from proground_log.perception.perceiver import Perceiver
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.opened import OpenedRun
from proground_log.run.settings import ReplayConfig
from replay.divergence.divergence import Divergence
from replay.divergence.ledger_check import LedgerCheck, LedgerDivergedError
from replay.plan import Plan
from replay.runner import ReplayStoppedError
from replay.session import open_runner, replay

Watchers = Callable[[int], Sequence[Sink]]


@dataclass(frozen=True)
class Excerpt:
    """A part of a run.

    Args:
        start: a kept checkpoint to begin at; None: the beginning.
        until_frame: stop after this frame of the log; None: go on to the end.
        keep_every: digest the state after every step, keep a checkpoint every so many frames, and
            leave telemetry out; None: as the run did.
    """

    start: Path | None = None
    until_frame: int | None = None
    keep_every: int | None = None

    def config(self, of_run: ReplayConfig) -> ReplayConfig:
        """The run's settings; what differs does not touch the map."""
        if self.keep_every is None:
            return of_run
        return replace(
            of_run,
            digest_every=1,
            checkpoint_every=self.keep_every,
            keep_checkpoints=True,
            telemetry=replace(of_run.telemetry, enabled=False),
        )


def rerun(
    manifest_path: Path,
    output: Path,
    *,
    check: bool = False,
    log: Path | None = None,
    perceiver: Perceiver | None = None,
    watchers: Watchers = lambda _: (),
    excerpt: Excerpt = Excerpt(),
    overwrite: bool = False,
) -> Divergence | None:
    """Replay what a manifest says, with its settings and its cost model.

    Args:
        manifest_path: manifest.json of a run, or the run's folder.
        output: folder of the new run.
        check: compare with the ledger beside the manifest, and stop at the first difference.
        log: the run's log, where it has moved.
        perceiver: finds the regions, where the run found them itself.
        watchers: given the number of frames to come, further sinks.
        excerpt: which part; a check begins at the beginning.
        overwrite: replace a run that is in `output`.

    Returns:
        The first difference; None where all is equal, or nothing was checked.

    Raises:
        ProgroundError: the log or the perception is not the run's.
        ReplayStoppedError: the user stopped it.
    """
    run = OpenedRun(manifest_path, log)
    _require_same_perception(run, perceiver)
    if excerpt.keep_every is not None and excerpt.keep_every < 1:
        raise ProgroundError("is less than 1", where="--keep-every", todo="give 1 or more")
    if output.resolve() == run.path.resolve():
        raise ProgroundError("is the run itself", where=output, todo="name another folder")
    sinks: list[Sink] = []
    if check:
        if excerpt.start is not None:
            raise ProgroundError(
                "a check begins at the beginning", where=excerpt.start, todo="leave --start out"
            )
        sinks.append(LedgerCheck(read_ledger(run.folder.require_finished().ledger)))
    try:
        replay(
            run.log.path,
            output,
            excerpt.config(run.manifest.config),
            start=excerpt.start,
            overwrite=overwrite,
            perceiver=perceiver,
            cost_model=run.manifest.cost_model,
            watchers=lambda frames: [*watchers(frames), *sinks],
            until_frame=excerpt.until_frame,
        )
    except LedgerDivergedError as error:
        return error.divergence
    except ReplayStoppedError as stop:
        if stop.is_interruption:
            raise
    return None


def state_after(
    manifest_path: Path,
    output: Path,
    *,
    frame: int,
    iteration: int,
    start: Path | None = None,
    log: Path | None = None,
    perceiver: Perceiver | None = None,
) -> None:
    """Replay up to a step in the middle of a frame, and keep the mapper's state after it.

    Args:
        manifest_path: manifest.json of a run, or the run's folder.
        output: the checkpoint to write (.safetensors).
        frame: number of the frame in its log.
        iteration: number of the step in the frame, from 0.
        start: a kept checkpoint before the frame; None: the beginning.
        log, perceiver: as for `rerun`.
    """
    run = OpenedRun(manifest_path, log)
    perception = _require_same_perception(run, perceiver)
    require_free(output, overwrite=False)
    if iteration < 0:
        raise ProgroundError("is less than 0", where="--until-step", todo="steps count from 0")
    telemetry = replace(run.manifest.config.telemetry, enabled=False)
    config = replace(run.manifest.config, telemetry=telemetry, keep_checkpoints=False)
    made_of = replace(run.manifest, config=config)
    plan = Plan(run.log, config, made_of.cost_model, learns=config.learns(perception))
    with disk_errors(output), TemporaryDirectory(dir=output.parent) as folder:
        scratch = RunFolder(Path(folder))
        if start is not None:
            checkpoint = Checkpoint.read(require_file(start))
            replace(checkpoint, ledger_lines=0, telemetry_bytes=[]).write(scratch.checkpoint)
        opened = open_runner(run.log, scratch, made_of, plan, perception, perceiver)
        with opened as (runner, _, _):
            runner.checkpoint_after(frame, iteration).write(output)


def _require_same_perception(
    run: OpenedRun, perceiver: Perceiver | None
) -> PerceptionDescription | None:
    """What the regions mean; raises a ProgroundError where others were seen in the run."""
    run.manifest.require_repeatable(run.path)
    perception = perceiver.description if perceiver is not None else perception_of(run.log)
    if fingerprint(perception) != run.manifest.perception_sha256:
        raise ProgroundError(
            "the perception is not the one that the run was made with",
            where=run.path,
            todo="give the same task and models, or none where the run had none",
        )
    return perception
