"""Budget sweeps: every cell is a replay and its evaluation, and none is done twice."""

from __future__ import annotations

import json
import signal
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from proground_log.errors import ProgroundError
from proground_log.evaluation.judge import evaluate_run
from proground_log.log.reader import LogReader
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.map_texts import Texts
from proground_log.perception.of_log import perception_of
from proground_log.perception.perceiver import Perceiver
from proground_log.query.surface import Surfaces
from proground_log.query.voxels import LOOK_VOXEL_M
from proground_log.run.cost_model import CostModel
from proground_log.run.folder import RunFolder
from proground_log.run.manifest import Manifest
from proground_log.run.opened import OpenedRun
from proground_log.run.settings import ReplayConfig
from replay.device import choose_device
from replay.plan import Plan
from replay.session import ReplayStoppedError, cost_model_of, replay
from replay.sweep.grid import Cell

OpenPerceiver = Callable[[LogReader], Perceiver | None]


@dataclass(frozen=True)
class Judging:
    """How maps are judged.

    Args:
        voxel_m: voxels of the mesh that is compared with the true one.
        texts: embeddings of names that the map does not know.
    """

    voxel_m: float = LOOK_VOXEL_M
    texts: Texts = Texts()


@dataclass(frozen=True)
class Job:
    """What a worker needs to know of a cell; can be pickled.

    Args:
        log_path: the log.
        folder: of the cell's run and scores.
        config: the settings.
        cost_model: what stages take.
        open_perceiver: finds the regions, for a log that has none.
        judging: how the map is judged.
    """

    log_path: Path
    folder: Path
    config: ReplayConfig
    cost_model: CostModel
    open_perceiver: OpenPerceiver
    judging: Judging


@dataclass(frozen=True)
class Result:
    """What became of a cell.

    Args:
        cell: the cell.
        figures: scores by name, and the counts of frames and steps; none where it failed.
        error: why it failed, or None.
    """

    cell: Cell
    figures: dict[str, float]
    error: str | None


class Engine(Protocol):
    """Where cells are computed."""

    @property
    def places(self) -> int:
        """Cells computed at once."""

    def run(self, job: Job) -> str | None:
        """Do a job; returns why it failed, or None. Called by several threads."""

    def stop(self) -> None:
        """Let all jobs stop after the frame at hand."""


def require_workers(workers: int | None) -> None:
    """Raise a ProgroundError where that many cannot compute."""
    if workers is not None and workers < 1:
        raise ProgroundError(
            f"{workers} workers cannot compute", where="--workers", todo="use 1 or more"
        )


def cell_folder(output: Path, cell: Cell) -> Path:
    """Where a cell's run and scores are."""
    return output / "cells" / cell.name


def jobs_left(
    log_path: Path,
    output: Path,
    cells: Sequence[Cell],
    open_perceiver: OpenPerceiver,
    judging: Judging = Judging(),
) -> list[Job]:
    """What is still to do, once everything that can be checked beforehand has been.

    Raises:
        ProgroundError: the output is a file, a cell there was made otherwise, the log is missing
            or has nothing to judge a map by, or a setting makes no sense.
    """
    reader = LogReader(log_path)
    if output.exists() and not output.is_dir():
        raise ProgroundError("is a file", where=output, todo="name a folder for the sweep")
    perceiver = open_perceiver(reader)
    perception = perceiver.description if perceiver is not None else perception_of(reader)
    usual = ReplayConfig()
    of_log = Manifest.of(log_path, usual, cost_model_of(usual), "cpu", perception)
    jobs = []
    for cell in cells:
        cost_model = cost_model_of(cell.config)
        _require_sound(reader, cell.config, cost_model, perception)
        folder = cell_folder(output, cell)
        job = Job(log_path, folder, cell.config, cost_model, open_perceiver, judging)
        run = RunFolder(job.folder)
        if run.manifest.is_file():
            wanted = replace(of_log, config=cell.config, cost_model=cost_model)
            for what in Manifest.read(run.manifest).differences(wanted):
                raise ProgroundError(
                    f"was made with another {what}",
                    where=job.folder,
                    todo="name another folder for the sweep, or remove this one",
                )
        if not (_is_replayed(run) and _is_judged(job)):
            jobs.append(job)
    return jobs


def _require_sound(
    reader: LogReader,
    config: ReplayConfig,
    cost_model: CostModel,
    perception: PerceptionDescription | None,
) -> None:
    choose_device(config.device)
    # Lock-step needs no time stamps, for which the whole log would be read, a cell at a time.
    lock_step = replace(config, simulation=replace(config.simulation, rate=0.0))
    plan = Plan(reader, lock_step, cost_model, learns=config.learns(perception))
    if not plan.held_out and reader.attachment(MESH_ATTACHMENT) is None:
        raise ProgroundError(
            "there is nothing to judge a map by: no frame is held out, the log has no true mesh",
            where=reader.path,
            todo="hold frames out with --hold-out-every",
        )


def _is_replayed(run: RunFolder) -> bool:
    """Whether the run came to its end and its manifest tells so."""
    is_whole = run.is_finished and run.ledger.is_file() and run.manifest.is_file()
    return is_whole and Manifest.read(run.manifest).result is not None


def _is_judged(job: Job) -> bool:
    judged = RunFolder(job.folder).evaluation
    return judged.is_file() and json.loads(judged.read_text())["voxel_m"] == job.judging.voxel_m


def run_jobs(
    jobs: Sequence[Job], engine: Engine, progress: Callable[[int, Sequence[str]], None]
) -> dict[str, str]:
    """Do all jobs; one that fails does not keep the others from their turn.

    Args:
        jobs: what is to do, begun in this order.
        engine: where.
        progress: told the jobs done, and the names of those at work.

    Returns:
        Why cells failed, by name.

    Raises:
        KeyboardInterrupt: the user stopped it; jobs at work were stopped after a frame.
    """
    errors: dict[str, str] = {}
    waiting, at_work = deque(jobs), dict[Future[str | None], str]()
    with ThreadPoolExecutor(engine.places, initializer=_block_ctrl_c) as threads:
        try:
            while waiting or at_work:
                while waiting and len(at_work) < engine.places:
                    job = waiting.popleft()
                    at_work[threads.submit(engine.run, job)] = job.folder.name
                progress(len(jobs) - len(waiting) - len(at_work), list(at_work.values()))
                for done in wait(at_work, return_when=FIRST_COMPLETED).done:
                    name, error = at_work.pop(done), done.result()
                    if error is not None:
                        errors[name] = error
        except BaseException:
            engine.stop()
            raise
    progress(len(jobs), [])
    return errors


def _block_ctrl_c() -> None:
    """Leave Ctrl-C to the main thread; the processes that this thread starts inherit it (POSIX)."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def attempt(job: Job, is_stopping: Callable[[], bool]) -> str | None:
    """Do a job in this process, from where it was left; returns why it failed, or None.

    Args:
        job: what is to do.
        is_stopping: asked after every frame.
    """
    try:
        _replay_and_judge(job, is_stopping)
    except (ProgroundError, ReplayStoppedError) as error:
        return str(error)
    except Exception:
        return traceback.format_exc()
    return None


def _replay_and_judge(job: Job, is_stopping: Callable[[], bool]) -> None:
    run = RunFolder(job.folder)
    if not _is_replayed(run):
        if run.evaluation.is_file():
            run.evaluation.unlink()
        replay(
            job.log_path,
            job.folder,
            job.config,
            resume=run.manifest.is_file() and not run.is_finished,
            overwrite=True,
            perceiver=job.open_perceiver(LogReader(job.log_path)),
            cost_model=job.cost_model,
            pause=_Stop(is_stopping),
        )

    def progress(*_: int) -> None:
        if is_stopping():
            raise ReplayStoppedError("stopped while it was judged")

    voxel_m, texts = job.judging.voxel_m, job.judging.texts
    surfaces = Surfaces(OpenedRun.finished(job.folder, job.log_path))
    evaluate_run(surfaces, voxel_m, progress, texts=texts).write(run.evaluation)


@dataclass(frozen=True)
class _Stop:
    """Pauses a replay for good."""

    is_stopping: Callable[[], bool]

    def wants(self, _: int) -> bool:
        return self.is_stopping()

    def go_on(self, _: int) -> bool:
        return False


def read_result(output: Path, cell: Cell, error: str | None) -> Result:
    """What a cell that was done left in its folder."""
    if error is not None:
        return Result(cell, {}, error)
    folder = cell_folder(output, cell)
    summary = Manifest.read(RunFolder(folder).manifest).result or {}
    counts = ("frames arrived", "frames mapped", "frames dropped", "frames held out", "steps")
    figures: dict[str, Any] = {
        name.replace(" ", "_"): summary[name] for name in counts if name in summary
    }
    figures |= json.loads(RunFolder(folder).evaluation.read_text())["scores"]
    return Result(cell, figures, None)
