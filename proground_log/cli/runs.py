"""Commands about runs: replay, diff, evaluate."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from proground_log.cli.common import (
    DIFFERENT,
    SAME,
    STOPPED,
    AsJson,
    Log,
    MaybeInt,
    MaybePath,
    Output,
    Run,
    err,
    print_table,
    shown_progress,
)
from proground_log.cli.perceivers import PerceptionOptions, perceiver_of_replay
from proground_log.errors import ProgroundError
from replay.config import ReplayConfig

if TYPE_CHECKING:
    from proground_log.events import Sink
    from replay.manifest import Manifest


def replay_command(
    log: Log,
    *,
    output: Output,
    config: Annotated[ReplayConfig, tyro.conf.arg(name="")] = ReplayConfig(),
    perception: Annotated[PerceptionOptions, tyro.conf.arg(name="")] = PerceptionOptions(),
    threads: MaybeInt = None,
    resume: bool = False,
    overwrite: bool = False,
) -> int:
    """Replay a log through the online mapper.

    Args:
        log: the log (.mcap).
        output: folder of the run.
        config: settings.
        perception: how regions are found, for a log that has none yet.
        threads: compute on so many; the result is the same for any number.
        resume: go on with an interrupted run, with the run's own settings.
        overwrite: replace a run that is there.
    """
    from proground_log.log.reader import LogReader
    from replay.device import set_threads
    from replay.session import ReplayStoppedError, replay

    set_threads(threads)
    perceiver = perceiver_of_replay(LogReader(log), perception)
    try:
        manifest = replay(
            log,
            output,
            config,
            resume=resume,
            overwrite=overwrite,
            perceiver=perceiver,
            watchers=_progress_watcher,
        )
    except ReplayStoppedError as stop:
        print(f"pglog: {stop}", file=sys.stderr)
        return STOPPED
    _print_summary(output, manifest)
    return SAME


def _progress_watcher(frames: int) -> list[Sink]:
    from replay.progress import ProgressSink

    return [ProgressSink(frames, err)]


def _print_summary(run: Path, manifest: Manifest) -> None:
    rows = {}
    for name, value in (manifest.result or {}).items():
        if isinstance(value, dict):
            value = ", ".join(f"{key} {number}" for key, number in value.items())
        rows[name] = str(value)
    print_table(str(run), rows)


def diff_command(first: Run, second: Run) -> int:
    """Name the first step at which two runs differ, and in what. Exit code 1 if they do.

    Args:
        first: folder of a run.
        second: folder of another.
    """
    from replay.diff import compare_runs

    comparison = compare_runs(first, second)
    for origin in comparison.origins:
        print(origin)
    divergence = comparison.divergence
    if divergence is not None:
        print(
            f"first difference: {divergence.cause}, at frame {divergence.frame}, "
            f"step {divergence.step} (ledger line {divergence.line})"
        )
        for detail in divergence.details:
            print(f"  {detail}")
    for name, difference in comparison.tensors.items():
        print(f"final {name}: {difference}")
    if comparison.is_same:
        print("the runs are equal, bit for bit")
    return SAME if comparison.is_same else DIFFERENT


def evaluate_command(
    run: Run,
    *,
    log: MaybePath = None,
    voxel_m: float = 0.02,
    ground_truth: MaybePath = None,
    names: MaybePath = None,
    mapping: MaybePath = None,
    vocabulary: MaybePath = None,
    text_encoder: MaybePath = None,
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
    from replay.evaluate import GroundTruth, Texts, evaluate_run

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
        result = evaluate_run(run, log, voxel_m, progress, ground_truth=truth, texts=texts)
    if as_json:
        print(json.dumps(dataclasses.asdict(result), indent=2))
        return SAME
    print_table(str(run), {name: f"{value:.2f}" for name, value in result.scores.items()})
    if result.classes:
        order = sorted(result.classes.items(), key=lambda item: (-item[1][0], item[0]))
        rows = {name: f"{top1:5.1f} % of {points}" for name, (points, top1) in order}
        print_table("Top-1 by class", rows)
    return SAME
