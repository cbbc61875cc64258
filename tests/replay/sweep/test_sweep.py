"""Sweeps: every cell is what a replay of its own gives, wherever and however often it is begun."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from pglog.commands import main
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.run.folder import RunFolder
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig, SimulationConfig, TelemetryConfig
from replay.session import replay
from replay.sweep.cells import (
    Job,
    Judging,
    Result,
    attempt,
    cell_folder,
    jobs_left,
    read_result,
    run_jobs,
)
from replay.sweep.grid import Cell, grid, read_axes, read_budgets, read_seeds
from replay.sweep.local import LocalEngine
from replay.sweep.report import draw, errors_of, table_rows, write_tables
from tests.replay.golden import SMALL
from tests.replay.small_replay import SMALL_FLAGS, ledger_bytes
from tests.writers.small_source import SmallSource, write_log

pytestmark = pytest.mark.slow

SWEPT = replace(SMALL, telemetry=TelemetryConfig(enabled=False))
SWEPT_FLAGS = SMALL_FLAGS[: SMALL_FLAGS.index("--telemetry.view-every")]
JUDGING = Judging(voxel_m=0.2)
CELLS = grid(SWEPT, (30.0, 100.0), (0,), ())


def no_perceiver(_: LogReader) -> None:
    """The room's log is mapped without meaning here."""


def jobs_of(log: Path, output: Path) -> list[Job]:
    return jobs_left(log, output, CELLS, no_perceiver, JUDGING)


def ledgers(output: Path) -> dict[str, bytes]:
    return {cell.name: ledger_bytes(cell_folder(output, cell)) for cell in CELLS}


def quiet(*_: object) -> None:
    """Shows no progress."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 12 small frames; read it, do not change it."""
    return write_log(tmp_path_factory.mktemp("small") / "small.mcap", SmallSource(12))


@pytest.fixture(scope="module")
def swept(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sweep by two workers; read it, do not change it."""
    output = tmp_path_factory.mktemp("swept")
    assert run_jobs(jobs_of(log, output), LocalEngine(2), quiet) == {}
    return output


# The grid.


def test_the_cells_come_in_order_and_have_their_settings() -> None:
    axes = read_axes(["mapper.sampling.rays=64,32", "simulation.overrun=wait"])
    cells = grid(SWEPT, read_budgets("50, 20"), read_seeds("1,0"), axes)
    found = [
        (c.budget_ms, c.config.mapper.sampling.rays, c.config.simulation.overrun, c.config.seed)
        for c in cells
    ]
    budgets_and_rays = [(50.0, 64), (50.0, 32), (20.0, 64), (20.0, 32)]
    assert found == [(b, rays, "wait", seed) for b, rays in budgets_and_rays for seed in (1, 0)]
    assert cells[0].name == ("budget_50ms_mapper.sampling.rays_64_simulation.overrun_wait_seed_1")
    assert len({cell.name for cell in cells}) == len(cells)
    first = cells[0].config
    sampling = replace(first.mapper.sampling, rays=SWEPT.mapper.sampling.rays)
    simulation = replace(first.simulation, budget_ms=None, overrun="drop-oldest")
    mapper = replace(first.mapper, sampling=sampling)
    assert replace(first, seed=0, mapper=mapper, simulation=simulation) == SWEPT


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("max_frames=none,5", (None, 5)),
        ("mapper.buffer.place-m=0.5,1", (0.5, 1.0)),
        ("mapper.semantics.enabled=true,false", (True, False)),
        ("mapper.semantics.space.features=geometry", ("geometry",)),
        ("simulation.rate=none,0.5", (None, 0.5)),
        ("simulation.cost=a/b,a_b", ("a/b", "a_b")),
    ],
)
def test_values_have_the_settings_type(text: str, values: tuple[object, ...]) -> None:
    (axis,) = read_axes([text])
    assert axis.values == values
    assert [type(value) for value in axis.values] == [type(value) for value in values]
    names = [cell.name for cell in grid(SWEPT, [1.0], [0], [axis])]
    assert len(set(names)) == len(values)
    assert not any("/" in name for name in names)


@pytest.mark.parametrize("text", ["0", "-5", "nan", "inf", "fast", "", "20,,50", "20,20.0", "20,"])
def test_budgets_that_are_none(text: str) -> None:
    with pytest.raises(ProgroundError, match="--budget-ms"):
        read_budgets(text)


@pytest.mark.parametrize("text", ["", "1.5", "one", "1,1"])
def test_seeds_that_are_none(text: str) -> None:
    with pytest.raises(ProgroundError, match="--seed"):
        read_seeds(text)


@pytest.mark.parametrize(
    ("texts", "complaint"),
    [
        (["mapper.sampling.ray=1"], "the nearest is mapper.sampling.rays"),
        (["queue=1"], "the nearest is simulation.queue"),
        (["mapper.sampling=1"], "there is no setting"),
        (["steps"], "has no values"),
        (["steps="], "a value is missing"),
        (["steps=1,x"], "'x' does not fit; give a whole number"),
        (["steps=1,1"], "1 is there twice"),
        (["steps=1", "steps=2"], "steps is set twice"),
        (["simulation.overrun=panic"], "give drop-oldest, drop-newest, wait"),
        (["max_frames=few"], "give a whole number or none"),
        (["seed=1,2"], "use --seed"),
        (["simulation.budget_ms=1"], "use --budget-ms"),
    ],
)
def test_settings_that_are_none(texts: list[str], complaint: str) -> None:
    with pytest.raises(ProgroundError, match="--set") as caught:
        read_axes(texts)
    assert complaint in str(caught.value)


# Before any cell is started.


def test_what_is_wrong_is_said_before_any_cell_is_started(log: Path, tmp_path: Path) -> None:
    output = tmp_path / "sweep"
    with pytest.raises(ProgroundError, match="no such file"):
        jobs_of(tmp_path / "missing.mcap", output)
    blocked = tmp_path / "file"
    blocked.touch()
    with pytest.raises(ProgroundError, match="is a file"):
        jobs_of(log, blocked)
    for text, complaint in [("simulation.queue=1,0", "--queue"), ("simulation.cost=x", "no cost")]:
        cells = grid(SWEPT, [50.0], [0], read_axes([text]))
        with pytest.raises(ProgroundError, match=complaint):
            jobs_left(log, output, cells, no_perceiver)
    cells = grid(replace(SWEPT, hold_out_every=13), [50.0], [0], ())
    with pytest.raises(ProgroundError, match="nothing to judge a map by"):
        jobs_left(log, output, cells, no_perceiver)
    with pytest.raises(ProgroundError, match="0 workers"):
        LocalEngine(0)
    assert not output.exists()


def test_a_cell_made_otherwise_is_refused(log: Path, swept: Path, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="another log"):
        jobs_of(write_log(tmp_path / "other.mcap", SmallSource(11)), swept)
    other = [replace(CELLS[0], config=replace(CELLS[0].config, digest_every=7))]
    with pytest.raises(ProgroundError, match="other settings"):
        jobs_left(log, swept, other, no_perceiver, JUDGING)


# Cells.


def test_a_cell_is_a_replay(log: Path, swept: Path, tmp_path: Path) -> None:
    replay(log, tmp_path / "run", CELLS[1].config)
    assert ledger_bytes(tmp_path / "run") == ledgers(swept)[CELLS[1].name]
    results = [read_result(swept, cell, None).figures for cell in CELLS]
    for figures in results:
        assert figures["views"] == figures["frames_held_out"] == 2
        assert figures["frames_mapped"] + figures["frames_dropped"] == 10
        assert {"psnr_db", "depth_l1_cm"} <= set(figures)
    assert results[0]["frames_dropped"] == 0 < results[1]["frames_dropped"]


def test_one_worker_gives_the_same(log: Path, swept: Path, tmp_path: Path) -> None:
    told: list[tuple[int, list[str]]] = []
    jobs = jobs_of(log, tmp_path)
    errors = run_jobs(jobs, LocalEngine(1), lambda done, names: told.append((done, list(names))))
    assert errors == {}
    assert told == [(0, [CELLS[0].name]), (1, [CELLS[1].name]), (2, [])]
    assert ledgers(tmp_path) == ledgers(swept)
    texts = []
    for output in (swept, tmp_path):
        results = [read_result(output, cell, None) for cell in CELLS]
        paths = write_tables(tmp_path, "log", results)
        texts.append([path.read_bytes() for path in paths])
    assert texts[0] == texts[1]


def test_what_is_finished_is_left_alone(log: Path, swept: Path, tmp_path: Path) -> None:
    assert jobs_of(log, swept) == []
    output = tmp_path / "copy"
    shutil.copytree(swept, output)
    run = RunFolder(cell_folder(output, CELLS[0]))
    scores = run.evaluation
    before = scores.read_bytes()
    scores.unlink()
    run.map.chmod(0o400)
    stamps_ns = [path.stat().st_mtime_ns for path in (run.ledger, run.map, run.manifest)]
    (job,) = jobs_of(log, output)
    assert attempt(job, lambda: False) is None
    assert scores.read_bytes() == before
    assert stamps_ns == [p.stat().st_mtime_ns for p in (run.ledger, run.map, run.manifest)]
    judged_finer = jobs_left(log, output, CELLS, no_perceiver, Judging(0.1))
    assert len(judged_finer) == 2


def test_a_run_whose_summary_was_lost_is_made_again(log: Path, swept: Path, tmp_path: Path) -> None:
    """As when the power fails after the map was written, and before the manifest."""
    output = tmp_path / "copy"
    shutil.copytree(swept, output)
    run = RunFolder(cell_folder(output, CELLS[0]))
    replace(Manifest.read(run.manifest), result=None).write(run.manifest)
    (job,) = jobs_of(log, output)
    assert attempt(job, lambda: False) is None
    assert ledgers(output) == ledgers(swept)
    assert read_result(output, CELLS[0], None) == read_result(swept, CELLS[0], None)


@pytest.mark.parametrize("frames", [1, 6])
def test_what_was_begun_is_gone_on_with(
    log: Path, swept: Path, tmp_path: Path, frames: int
) -> None:
    job = jobs_of(log, tmp_path)[0]
    asked = iter(range(1, 100))
    stopped = attempt(job, lambda: next(asked) >= frames)
    assert stopped is not None
    assert "stopped after" in stopped
    assert RunFolder(job.folder).checkpoint.is_file()
    (again, _) = jobs_of(log, tmp_path)
    assert attempt(again, lambda: False) is None
    assert ledger_bytes(job.folder) == ledgers(swept)[CELLS[0].name]
    assert read_result(tmp_path, CELLS[0], None) == read_result(swept, CELLS[0], None)


def die(_: LogReader) -> None:
    """What happens to a process that takes too much memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_process_that_is_killed_is_a_cell_that_failed(log: Path, tmp_path: Path) -> None:
    first, second = jobs_of(log, tmp_path)
    jobs = [replace(first, open_perceiver=die), second]
    errors = run_jobs(jobs, LocalEngine(2), quiet)
    assert list(errors) == [CELLS[0].name]
    assert "was killed" in errors[CELLS[0].name]
    assert jobs_of(log, tmp_path) == [first]


def broken(_: LogReader) -> None:
    raise ZeroDivisionError("a fault of ours")


def test_a_fault_of_ours_tells_where_it_is(log: Path, tmp_path: Path) -> None:
    error = attempt(replace(jobs_of(log, tmp_path)[0], open_perceiver=broken), lambda: False)
    assert error is not None
    assert "in broken" in error
    results = [Result(CELLS[0], {}, error)]
    assert errors_of(results) == {CELLS[0].name: "ZeroDivisionError: a fault of ours"}


# The command.


def sweep_arguments(log: Path, output: Path) -> list[str]:
    options = ["--budget-ms", "30,100", "--voxel-m", "0.2", "--workers", "1"]
    return ["sweep", str(log), "-o", str(output), *options, *SWEPT_FLAGS]


def pglog(monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> object:
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.setattr(sys, "argv", ["pglog", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code


def test_the_command_tells_of_cells_that_failed_and_mends_them(
    log: Path,
    swept: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    done, failing = (cell_folder(tmp_path, cell) for cell in CELLS)
    shutil.copytree(cell_folder(swept, CELLS[0]), done)
    failing.touch()
    assert pglog(monkeypatch, sweep_arguments(log, tmp_path)) == 2
    printed = capsys.readouterr()
    assert f"cell {CELLS[1].name} failed: {failing}: is a file" in printed.err
    assert "failed" in printed.out
    with (tmp_path / "sweep.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["budget_ms"] for row in rows] == ["30", "100"]
    assert [bool(row["psnr_db"]) for row in rows] == [True, False]
    assert "is a file" in rows[1]["error"]
    failing.unlink()
    assert pglog(monkeypatch, sweep_arguments(log, tmp_path)) == 0
    assert ledgers(tmp_path) == ledgers(swept)
    found = json.loads((tmp_path / "sweep.json").read_text())["cells"]
    assert [cell["figures"] for cell in found] == [
        read_result(swept, cell, None).figures for cell in CELLS
    ]
    assert all(cell["error"] is None for cell in found)


def test_the_command_names_cells_that_had_no_time_for_a_step(
    log: Path,
    swept: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(cell_folder(swept, CELLS[1]), cell_folder(tmp_path, CELLS[1]))
    arguments = ["5,100" if word == "30,100" else word for word in sweep_arguments(log, tmp_path)]
    assert pglog(monkeypatch, arguments) == 0
    printed = capsys.readouterr()
    (warning,) = (line for line in printed.err.splitlines() if "warning" in line)
    assert "no step was done in budget_5ms_seed_0: the map has learnt nothing" in warning
    assert " 0.00 " in next(
        line for line in printed.out.splitlines() if line.startswith("│         5")
    )


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--budget-ms", "0"], "--budget-ms"),
        (["--budget-ms", "50", "--set", "mapper.sampling.ray=3"], "mapper.sampling.rays"),
        (["--budget-ms", "50", "--ray-address", "here"], "--engine ray"),
        (["--budget-ms", "50", "--queue", "0"], "--queue"),
    ],
)
def test_a_wrong_command_line(
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    complaint: str,
) -> None:
    arguments = ["sweep", str(log), "-o", str(tmp_path / "sweep"), *options]
    assert pglog(monkeypatch, arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("pglog: ")
    assert complaint in printed.err
    assert not (tmp_path / "sweep").exists()


def is_gone(group: int) -> bool:
    """Whether no process of a group is left, be it after a while."""
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_ctrl_c_stops_after_a_frame_and_the_same_command_goes_on(
    log: Path, swept: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "pglog", *sweep_arguments(log, tmp_path)]
    process = subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    partial = [RunFolder(cell_folder(tmp_path, cell)).partial_ledger for cell in CELLS]
    while not any(path.is_file() for path in partial) and process.poll() is None:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, told = process.communicate()
    assert process.returncode == 130
    assert told.endswith("pglog: stopped; the same command goes on\n")
    assert "Traceback" not in told
    assert is_gone(process.pid)
    begun = [RunFolder(cell_folder(tmp_path, cell)) for cell in CELLS]
    assert any(run.checkpoint.is_file() for run in begun)
    left = jobs_of(log, tmp_path)
    assert left
    assert not any(attempt(job, lambda: False) for job in left)
    assert ledgers(tmp_path) == ledgers(swept)


# The report.


def result(budget_ms: float, rays: int, seed: int, psnr_db: float | None) -> Result:
    config = replace(ReplayConfig(seed=seed), simulation=SimulationConfig(budget_ms=budget_ms))
    cell = Cell(f"{budget_ms}-{rays}-{seed}", config, {"mapper.sampling.rays": rays})
    if psnr_db is None:
        return Result(cell, {}, "cell: went wrong; try again")
    return Result(cell, {"psnr_db": psnr_db, "frames_dropped": 2, "steps": 10}, None)


def test_the_table_has_means_and_spreads_over_seeds(tmp_path: Path) -> None:
    results = [
        *(result(20, 64, seed, psnr) for seed, psnr in enumerate([20.0, 22.0, 24.0])),
        *(result(50, 64, seed, psnr) for seed, psnr in enumerate([25.0, None, 27.0])),
        *(result(50, 32, seed, None) for seed in range(3)),
    ]
    rows = table_rows(results)
    assert [(row["budget ms"], row["mapper.sampling.rays"]) for row in rows] == [
        ("20", "64"),
        ("50", "64"),
        ("50", "32"),
    ]
    assert [row["PSNR dB"] for row in rows] == ["22.00 ± 2.00", "26.00 ± 1.41", "–"]
    assert "Top-1 %" not in rows[0]
    assert [row["failed seeds"] for row in rows] == ["", "1", "0, 1, 2"]
    assert "failed seeds" not in table_rows(results[:3])[0]
    pictures = draw(tmp_path, results)
    assert [path.name for path in pictures] == ["sweep_psnr_db.png", "sweep_frames_dropped.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    again = draw(tmp_path / "again", results)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in pictures]


# On ray.


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory, log: Path) -> Iterator[Path]:
    """A sweep's folder, with a cluster of two workers at hand."""
    pytest.importorskip("ray", reason="ray is not installed: pip install proground-log[ray]")
    from replay.sweep.ray import open_ray

    output = tmp_path_factory.mktemp("ray")
    with open_ray(log, output, workers=2) as engine:
        assert run_jobs(jobs_of(log, output), engine, quiet) == {}
        yield output
    assert [path.name for path in output.iterdir()] == ["cells"]


def test_ray_gives_the_same(cluster: Path, swept: Path) -> None:
    assert ledgers(cluster) == ledgers(swept)
    for cell in CELLS:
        assert read_result(cluster, cell, None) == read_result(swept, cell, None)


@pytest.mark.usefixtures("cluster")
def test_ray_sends_log_and_cell_to_nodes_that_do_not_see_them(
    log: Path, swept: Path, tmp_path: Path
) -> None:
    from replay.sweep.ray import RayEngine

    moving = shutil.copyfile(log, tmp_path / "moving.mcap")
    job = jobs_of(moving, tmp_path / "sweep")[0]
    asked = iter(range(1, 100))
    assert attempt(job, lambda: next(asked) >= 5) is not None
    begun = RunFolder(job.folder).partial_ledger.read_bytes()
    engine = RayEngine(moving, tmp_path / "no token", 1, ships_log=True)
    moving.unlink()
    assert engine.run(job) is None
    assert ledger_bytes(job.folder).startswith(begun)
    assert ledger_bytes(job.folder) == ledgers(swept)[CELLS[0].name]
    assert Manifest.read(RunFolder(job.folder).manifest).log_path == str(moving)
    assert read_result(tmp_path / "sweep", CELLS[0], None).figures["views"] == 2


def die_once(reader: LogReader) -> None:
    marker = reader.path.with_suffix(".died")
    if not marker.exists():
        marker.touch()
        die(reader)


@pytest.mark.usefixtures("cluster")
def test_ray_tries_again_when_a_worker_is_lost_and_stops_when_told(
    log: Path, swept: Path, tmp_path: Path
) -> None:
    from replay.sweep.ray import RayEngine

    first, second = jobs_of(log, tmp_path)
    engine = RayEngine(log, tmp_path / "no token", 1, ships_log=False)
    assert engine.run(replace(first, open_perceiver=die_once)) is None
    assert log.with_suffix(".died").exists()
    assert ledger_bytes(first.folder) == ledgers(swept)[CELLS[0].name]
    engine.stop()
    stopped = engine.run(second)
    assert stopped is not None
    assert "stopped after" in stopped
    assert RunFolder(second.folder).checkpoint.is_file()


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:99999"])
def test_an_address_without_a_cluster(log: Path, tmp_path: Path, address: str) -> None:
    pytest.importorskip("ray", reason="ray is not installed: pip install proground-log[ray]")
    from replay.sweep.ray import open_ray

    with (
        pytest.raises(ProgroundError, match="no ray cluster answers"),
        open_ray(log, tmp_path / "sweep", address=address),
    ):
        pass
    assert not (tmp_path / "sweep").exists()


def test_without_ray_it_is_said_what_to_install(
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "replay.sweep.ray", raising=False)
    arguments = [*sweep_arguments(log, tmp_path / "sweep"), "--engine", "ray"]
    assert pglog(monkeypatch, arguments) == 2
    assert "pip install proground-log[ray]" in capsys.readouterr().err
    assert not (tmp_path / "sweep").exists()
