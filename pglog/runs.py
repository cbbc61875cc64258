"""Commands about runs: replay, evaluate."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table
from tyro.conf import Positional

from pglog.common import (
    SAME,
    STOPPED,
    AsJson,
    Output,
    Run,
    frames_watched,
    out,
    print_table,
    shown_progress,
    warn,
)
from pglog.pause import TerminalPause
from pglog.rerun import rerun_command
from proground_log.errors import ProgroundError
from proground_log.perception.opening import PerceptionOptions, perceiver_of_replay
from proground_log.query.voxels import LOOK_VOXEL_M
from proground_log.run.settings import ReplayConfig

if TYPE_CHECKING:
    from proground_log.run.manifest import Manifest


def replay_command(
    log: Positional[Path | None] = None,
    *,
    output: Output,
    config: Annotated[ReplayConfig, tyro.conf.arg(name="")] = ReplayConfig(),
    perception: Annotated[PerceptionOptions, tyro.conf.arg(name="")] = PerceptionOptions(),
    threads: int | None = None,
    resume: bool = False,
    from_checkpoint: Path | None = None,
    until_frame: int | None = None,
    pause_at: Annotated[tuple[int, ...], tyro.conf.arg(metavar="FRAME ...")] = (),
    manifest: Path | None = None,
    check: bool = False,
    overwrite: bool = False,
) -> int:
    """Replay a log through the online mapper.

    Args:
        log: the log (.mcap); with --manifest it is found where the run found it.
        output: folder of the run.
        config: settings.
        perception: how regions are found, for a log that has none yet.
        threads: compute on so many; the result is the same for any number.
        resume: go on with an interrupted run, with the run's own settings.
        from_checkpoint: begin at a kept checkpoint of another run of this log, with its settings.
        until_frame: stop after this frame; --resume goes on.
        pause_at: pause after these frames.
        manifest: run this run again (a manifest.json), with its own settings.
        check: with it: compare with its ledger, and stop at the first difference (exit code 1).
        overwrite: replace a run that is there.
    """
    from proground_log.log.reader import LogReader
    from replay.device import set_threads
    from replay.session import ReplayStoppedError, replay

    if manifest is not None:
        if config != ReplayConfig() or resume or from_checkpoint is not None or pause_at:
            raise ProgroundError(
                "--manifest brings its own settings",
                where="replay",
                todo="leave out all but LOG, -o, --check, --until-frame, --threads and perception",
            )
        return rerun_command(
            manifest,
            output=output,
            check=check,
            log=log,
            perception=perception,
            threads=threads,
            until_frame=until_frame,
            overwrite=overwrite,
        )
    if log is None or check:
        missing = "--manifest" if check else "LOG"
        raise ProgroundError(f"{missing} is missing", where="replay", todo="give it")
    set_threads(threads)
    pause = TerminalPause(pause_at) if pause_at else None
    try:
        result = replay(
            log,
            output,
            config,
            resume=resume,
            start=from_checkpoint,
            overwrite=overwrite,
            perceiver=perceiver_of_replay(LogReader(log), perception),
            watchers=frames_watched,
            warn=warn,
            until_frame=until_frame,
            pause=pause,
        )
    except ReplayStoppedError as stop:
        print(f"pglog: {stop}", file=sys.stderr)
        return STOPPED if stop.is_interruption else SAME
    print_summary(output, result)
    return SAME


def print_summary(run: Path, manifest: Manifest) -> None:
    """The figures of a finished run, and simulated time beside the machine's."""
    result = dict(manifest.result or {})
    simulated, machine = (_figures(result.pop(name, {})) for name in ("simulation", "machine s"))
    figures = {name: str(value) for name, value in result.items()}
    print_table(str(run), {"mapper": manifest.config.kind, **figures})
    model = manifest.cost_model
    stages = Table("seconds", f"simulated ({model.name})", "this machine")
    for stage, seconds in machine.items():
        stages.add_row(stage, _seconds(simulated.pop(f"{stage} s", None)), _seconds(seconds))
    stages.add_row("idle", _seconds(simulated.pop("idle s", None)), "")
    out.print(stages)
    # What the first table has already.
    rest = {name: str(value) for name, value in simulated.items() if name not in result}
    print_table("simulated schedule", rest)
    if result.get("steps") == 0:
        warn(f"{run}: no step was done; the map has learnt nothing")


def _figures(part: object) -> dict[str, float]:
    return dict(part) if isinstance(part, dict) else {}


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def evaluate_command(
    run: Run,
    *,
    log: Path | None = None,
    voxel_m: float = LOOK_VOXEL_M,
    ground_truth: Path | None = None,
    names: Path | None = None,
    mapping: Path | None = None,
    vocabulary: Path | None = None,
    text_encoder: Path | None = None,
    as_json: AsJson = False,
) -> int:
    """Judge a map by the frames held out of it, by the true mesh, and by labels.

    Args:
        run: folder of a finished run.
        log: its log, where it has moved.
        voxel_m: voxels of the mesh that is compared with the true one.
        ground_truth: a mesh with labels (.ply) in place of the log's.
        names: with it: the candidate names (.csv, or text with one a line).
        mapping: with it: what labels are called among them (.csv: category, nyuClass).
        vocabulary: embeddings of names that are none of the task's prompts (.npz).
        text_encoder: computes the embeddings of such names (.onnx).
        as_json: print JSON, for programs.
    """
    from proground_log.evaluation.judge import GroundTruth, evaluate_run
    from proground_log.perception.map_texts import Texts
    from proground_log.query.surface import Surfaces
    from proground_log.run.opened import OpenedRun

    truth = None
    if (ground_truth is None) != (names is None) or (mapping and names is None):
        raise ProgroundError(
            "--ground-truth and --names go together, --mapping with them",
            where="evaluate",
            todo="give all, or none",
        )
    if ground_truth is not None and names is not None:
        truth = GroundTruth(ground_truth, names, mapping)
    texts = Texts(vocabulary, text_encoder)
    with shown_progress("evaluate") as progress:
        surfaces = Surfaces(OpenedRun.finished(run, log))
        result = evaluate_run(surfaces, voxel_m, progress, ground_truth=truth, texts=texts)
    if truth is None:
        try:
            result.write(surfaces.run.folder.evaluation)
        except ProgroundError as error:  # The figures are shown all the same.
            warn(str(error))
    if as_json:
        print(json.dumps(result.to_json(), indent=2))
        return SAME
    print_table(str(run), {name: f"{value:.2f}" for name, value in result.scores.items()})
    if result.classes:
        order = sorted(result.classes.items(), key=lambda item: (-item[1][0], item[0]))
        rows = {name: f"{top1:5.1f} % of {points}" for name, (points, top1) in order}
        print_table("Top-1 by class", rows)
    if result.instances:
        counts = sorted(result.instances.items(), key=lambda item: (-item[1].true, item[0]))
        rows = {
            name: f"{each.true} true, {each.found} found, {each.matched[0.25]} of them right"
            for name, each in counts
        }
        print_table("objects by class, at IoU 0.25", rows)
    return SAME
