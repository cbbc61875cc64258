"""The command that finds out what a budget of time costs: sweep."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.table import Column, Table

from pglog.common import FAILED, SAME, STOPPED, Log, Output, err, out, warn
from proground_log.errors import ProgroundError
from proground_log.perception.opening import PerceptionOptions, perceiver_of_replay
from proground_log.query.voxels import LOOK_VOXEL_M
from proground_log.run.settings import ReplayConfig, SimulationConfig, TelemetryConfig

if TYPE_CHECKING:
    from replay.sweep.cells import Engine

SweptFloat = tyro.conf.Suppress[tyro.conf.Fixed[float | None]]
SweptInt = tyro.conf.Suppress[tyro.conf.Fixed[int]]
OffTelemetry = tyro.conf.Suppress[tyro.conf.Fixed[TelemetryConfig]]


@dataclass(frozen=True)
class SweptSimulation(SimulationConfig):
    """Simulated time, all but the budget."""

    budget_ms: SweptFloat = None


SIMULATION = SweptSimulation()
NO_TELEMETRY = TelemetryConfig(enabled=False)


@dataclass(frozen=True)
class SweptConfig(ReplayConfig):
    """A replay's settings, all but those that a sweep gives each cell."""

    seed: SweptInt = 0
    hold_out_every: int = 10
    """Keep every so many-th arriving frame from the mapper, to judge the map by."""
    simulation: Annotated[SweptSimulation, tyro.conf.arg(name="")] = SIMULATION
    telemetry: OffTelemetry = NO_TELEMETRY

    def of_a_cell(self) -> ReplayConfig:
        """The settings that all cells start from."""
        simulation = SimulationConfig(**vars(self.simulation))
        return ReplayConfig(**{**vars(self), "simulation": simulation})


SETTINGS = SweptConfig()


def sweep_command(
    log: Log,
    *,
    output: Output,
    budget_ms: Annotated[str, tyro.conf.arg(metavar="MS,MS,...")],
    seed: Annotated[str, tyro.conf.arg(metavar="INT,INT,...")] = "0",
    settings: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(name="set", metavar="KEY=VALUE,VALUE,..."),
    ] = (),
    engine: Literal["local", "ray"] = "local",
    workers: int | None = None,
    voxel_m: float = LOOK_VOXEL_M,
    ray_address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    config: Annotated[SweptConfig, tyro.conf.arg(name="")] = SETTINGS,
    perception: Annotated[PerceptionOptions, tyro.conf.arg(name="")] = PerceptionOptions(),
) -> int:
    """Replay a log under every budget, with every seed and setting, and judge each map.

    See docs/sweep.md. What was finished is not computed again, and what was begun is gone on with.

    Args:
        log: the log (.mcap).
        output: folder for the cells, table, CSV, JSON and plots.
        budget_ms: simulated time that a mapped frame may take.
        seed: of every random draw.
        settings: values of a setting by its path, such as mapper.sampling.rays=512,1024.
        engine: processes of this computer, or a ray cluster.
        workers: cells at once, by default one a core.
        voxel_m: voxels of the mesh that is compared with the true one.
        ray_address: of the cluster; without it, one is started on this computer.
        config: settings of all cells.
        perception: how regions are found, for a log that has none yet.
    """
    from proground_log.files import file_sha256
    from proground_log.perception.map_texts import Texts
    from replay.sweep.cells import Judging, jobs_left, read_result, run_jobs
    from replay.sweep.grid import grid, read_axes, read_budgets, read_seeds
    from replay.sweep.report import draw, errors_of, table_rows, write_tables

    # Workers may run elsewhere, where a relative path means something else.
    log, output, perception = log.resolve(), output.resolve(), _resolved(perception)
    base = config.of_a_cell()
    budgets_ms, seeds = read_budgets(budget_ms), read_seeds(seed)
    axes = read_axes(settings, base)
    cells = grid(base, budgets_ms, seeds, axes)
    opener = partial(perceiver_of_replay, options=perception)
    judging = Judging(voxel_m, Texts(perception.vocabulary, perception.text_encoder))
    jobs = jobs_left(log, output, cells, opener, judging)
    errors: dict[str, str] = {}
    if jobs:
        try:
            with (
                _opened(engine, log, output, workers, ray_address) as opened,
                _progress(len(cells), len(cells) - len(jobs)) as progress,
            ):
                errors = run_jobs(jobs, opened, progress)
        except KeyboardInterrupt:
            print("pglog: stopped; the same command goes on", file=sys.stderr)
            return STOPPED
    results = [read_result(output, cell, errors.get(cell.name)) for cell in cells]
    rows = table_rows(results)
    table = Table(*(Column(title, justify="right", overflow="fold") for title in rows[0]))
    for row in rows:
        table.add_row(*row.values())
    print(f"{log}: mean ± standard deviation, seeds {seed}")
    out.print(table)
    for name, error in errors_of(results).items():
        print(f"pglog: cell {name} failed: {error}", file=sys.stderr)
    idle = [result.cell.name for result in results if result.figures.get("steps") == 0]
    if idle:
        warn(f"no step was done in {', '.join(idle)}: the map has learnt nothing there")
    for path in (*write_tables(output, file_sha256(log), results), *draw(output, results)):
        print(path)
    return FAILED if errors else SAME


def _resolved(options: PerceptionOptions) -> PerceptionOptions:
    """The options with whole paths."""
    paths: dict[str, Any] = {
        name: path.resolve() for name, path in vars(options).items() if isinstance(path, Path)
    }
    return dataclasses.replace(options, **paths)


def _opened(
    engine: str, log: Path, output: Path, workers: int | None, ray_address: str | None
) -> AbstractContextManager[Engine]:
    """Where cells are computed."""
    if engine == "ray":
        from replay.sweep.ray import open_ray

        return open_ray(log, output, workers, ray_address)
    from replay.sweep.local import LocalEngine

    if ray_address is not None:
        raise ProgroundError(
            "only ray has a cluster", where="--ray-address", todo="add --engine ray"
        )
    return nullcontext(LocalEngine(workers))


@contextmanager
def _progress(total: int, before: int) -> Iterator[Callable[[int, Sequence[str]], None]]:
    """A bar of the cells done, with the names of those at work."""
    from pglog.progress import progress_bar

    bar = progress_bar(err)
    task = bar.add_task("sweep", total=total, completed=before, note="")

    def show(done: int, at_work: Sequence[str]) -> None:
        bar.update(task, completed=before + done, note=", ".join(at_work))

    with bar:
        yield show
