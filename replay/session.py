"""Starting a replay: a new run, one to resume, or one that begins at a checkpoint."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from proground_log.errors import ProgroundError
from proground_log.events import Sink
from proground_log.files import disk_errors, file_sha256, require_file, require_free
from proground_log.log.reader import LogReader
from proground_log.mapping.kinds import mapper_kind
from proground_log.mapping.map_file import save_map
from proground_log.mapping.mapper import Mapper
from proground_log.perception.description import PerceptionDescription, fingerprint
from proground_log.perception.of_log import perception_of
from proground_log.perception.perceiver import Perceiver
from proground_log.run.cost_model import CostModel
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig
from replay.device import choose_device
from replay.plan import Plan
from replay.runner import Pause, ReplayStoppedError, Runner
from replay.sinks import Sinks

__all__ = ["ReplayStoppedError", "cost_model_of", "replay"]


def replay(
    log_path: Path,
    run_path: Path,
    config: ReplayConfig,
    *,
    resume: bool = False,
    start: Path | None = None,
    overwrite: bool = False,
    perceiver: Perceiver | None = None,
    cost_model: CostModel | None = None,
    watchers: Callable[[int], Sequence[Sink]] = lambda _: (),
    warn: Callable[[str], None] = lambda _: None,
    until_frame: int | None = None,
    pause: Pause | None = None,
) -> Manifest:
    """Replay a log into a run.

    Args:
        log_path: the log.
        run_path: folder of the run.
        config: the settings; with `resume` those of the run itself hold.
        resume: go on with an interrupted run.
        start: a kept checkpoint of another run of the log, to begin at; its ledger up to there
            becomes this run's. Without settings those of that run hold.
        overwrite: replace a run that is there.
        perceiver: finds the regions of each frame, for a log that has none yet.
        cost_model: what stages take, in place of the one that the settings name.
        watchers: given the number of frames to come, further sinks, such as a progress bar.
        warn: told beforehand where the budget never holds a step.
        until_frame: stop after this frame of the log, as if the user had.
        pause: asked after every frame whether to go on.

    Returns:
        The manifest of the finished run, with its summary.

    Raises:
        ReplayStoppedError: the user stopped it; the run can be resumed.
    """
    reader, run = LogReader(log_path), RunFolder(run_path)
    perception = perceiver.description if perceiver is not None else perception_of(reader)
    if resume:
        manifest = _manifest_to_resume(run, log_path, config, perception)
        if run.is_finished:
            return manifest
        plan = _plan(reader, manifest, perception)
    else:
        require_free(run.manifest, overwrite=overwrite)
        if run_path.exists() and not run_path.is_dir():
            raise ProgroundError("is a file", where=run_path, todo="name a folder for the run")
        checkpoint = None
        if start is not None:
            checkpoint, origin = Checkpoint.read(require_file(start)), _origin_of(start, run)
            if config == ReplayConfig():
                config = origin.config
            cost_model = cost_model or origin.cost_model
        device = choose_device(config.device)
        model = cost_model or cost_model_of(config)
        manifest = Manifest.of(log_path, config, model, device, perception)
        if start is not None:
            _require_same_map(manifest, origin, start)
        plan = _plan(reader, manifest, perception)
        with disk_errors(run_path):
            run_path.mkdir(parents=True, exist_ok=True)
        run.clear()
        manifest.write(run.manifest)
        if checkpoint is not None and start is not None:
            _begin_at(checkpoint, start, run)
    if (warning := plan.warning()) is not None:
        warn(warning)
    opened = open_runner(
        reader, run, manifest, plan, perception, perceiver, watchers, until_frame, pause
    )
    with opened as (runner, mapper, sinks), _stop_on_signals(runner):
        summary = runner.run()
    manifest = replace(manifest, result=summary)
    manifest.write(run.manifest)
    sinks.finish()
    # The map comes last: it says that the run is finished.
    save_map(run.map, mapper.map())
    run.forget_progress()
    return manifest


class OpenedRunner(NamedTuple):
    """A replay that is ready to go on."""

    runner: Runner
    mapper: Mapper
    sinks: Sinks


@contextmanager
def open_runner(
    reader: LogReader,
    run: RunFolder,
    manifest: Manifest,
    plan: Plan,
    perception: PerceptionDescription | None,
    perceiver: Perceiver | None = None,
    watchers: Callable[[int], Sequence[Sink]] = lambda _: (),
    until_frame: int | None = None,
    pause: Pause | None = None,
) -> Iterator[OpenedRunner]:
    """Make mapper, sinks and runner of a run, at its checkpoint where it has one.

    Args:
        reader: the log.
        run: where ledger and telemetry go.
        manifest: what makes the run.
        plan: the turns of its frames.
        perception: what the regions of the frames mean; None where there are none.
        perceiver, watchers, until_frame, pause: as for `replay`.
    """
    config = manifest.config
    checkpoint = Checkpoint.read(run.checkpoint) if run.checkpoint.is_file() else None
    mapper = mapper_kind(config.kind).make(
        config.mapper,
        bounds=reader.recording.bounds,
        seed=config.seed,
        device=choose_device(config.device),
        perception=perception,
    )
    if checkpoint is not None:
        mapper.restore(checkpoint.state)
    ahead = sum(1 for _ in plan.turns()) - (0 if checkpoint is None else checkpoint.turns)
    recording_id = f"{manifest.log_sha256[:16]}-{config.seed}"
    drawn_as = recording_id if config.telemetry.enabled else None
    with Sinks(run, checkpoint, drawn_as, watchers(ahead)) as sinks:
        runner = Runner(
            reader,
            run,
            config,
            plan,
            mapper,
            sinks,
            perceiver=perceiver,
            checkpoint=checkpoint,
            until_frame=until_frame,
            pause=pause,
        )
        yield OpenedRunner(runner, mapper, sinks)


def cost_model_of(config: ReplayConfig) -> CostModel:
    """The one that the settings name, for a computer as slow as they say."""
    scale = config.simulation.cost_scale
    model = CostModel.load(config.simulation.cost).scaled(scale)
    return model.with_costs(mapper_kind(config.kind).costs, scale)


def _plan(reader: LogReader, manifest: Manifest, perception: PerceptionDescription | None) -> Plan:
    config = manifest.config
    return Plan(reader, config, manifest.cost_model, learns=config.learns(perception))


def _begin_at(checkpoint: Checkpoint, path: Path, run: RunFolder) -> None:
    """Give a new run the state of a checkpoint, and the ledger of its run up to there."""
    origin = _run_of(path)
    ledger = require_file(origin.ledger if origin.ledger.is_file() else origin.partial_ledger)
    with disk_errors(run.path), ledger.open() as lines, run.partial_ledger.open("w") as kept:
        kept.writelines(islice(lines, checkpoint.ledger_lines))
    # The telemetry of the other run stays there: this run's begins here.
    replace(checkpoint, telemetry_bytes=[]).write(run.checkpoint)


def _run_of(checkpoint: Path) -> RunFolder:
    """The run that kept a checkpoint."""
    return RunFolder(checkpoint.resolve().parent.parent)


def _origin_of(checkpoint: Path, run: RunFolder) -> Manifest:
    """What made the run that a checkpoint is of; that is not the run about to be written."""
    origin = _run_of(checkpoint)
    if origin.path == run.path.resolve():
        raise ProgroundError(
            "keeps the checkpoint to begin at", where=run.path, todo="name another folder"
        )
    manifest = Manifest.read(origin.manifest)
    manifest.require_repeatable(origin.path)
    return manifest


BOOKKEEPING = ("digest_every", "checkpoint_every", "keep_checkpoints", "telemetry")
"""Settings that touch no map."""


def _require_same_map(manifest: Manifest, origin: Manifest, checkpoint: Path) -> None:
    """Raise a ProgroundError unless both runs do the same up to the checkpoint."""
    for what in manifest.differences(origin, but=BOOKKEEPING):
        raise ProgroundError(
            f"is of a run with another {what}",
            where=checkpoint,
            todo="give the same log and perception, and leave the settings out",
        )


def _manifest_to_resume(
    run: RunFolder,
    log_path: Path,
    config: ReplayConfig,
    perception: PerceptionDescription | None,
) -> Manifest:
    if not run.manifest.is_file():
        raise ProgroundError(
            "there is no run to resume", where=run.path, todo="leave out --resume to start one"
        )
    manifest = Manifest.read(run.manifest)
    manifest.require_repeatable(run.path)
    given = replace(
        manifest,
        log_sha256=file_sha256(log_path),
        config=manifest.config if config == ReplayConfig() else config,
        perception_sha256=fingerprint(perception),
    )
    for what in manifest.differences(given):
        raise ProgroundError(
            f"the {what} {'are' if what == 'settings' else 'is'} not what the run was started with",
            where=log_path if what == "log" else run.path,
            todo={
                "settings": "leave the options out: --resume goes on with the run's own",
                "log": f"give the same log (it was {manifest.log_path})",
            }.get(what, "give the same task and models"),
        )
    return manifest


@contextmanager
def _stop_on_signals(runner: Runner) -> Iterator[None]:
    """Let Ctrl-C stop the replay after a frame; a second one stops it at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, _: object) -> None:
        runner.stop()
        signal.signal(number, previous[signal.Signals(number)])

    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number in previous:
            signal.signal(number, handle)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
