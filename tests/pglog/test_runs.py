"""`pglog replay` and what looks at a run: results on stdout, the rest on stderr, exit codes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from proground_log.run.cost_model import DEFAULT_MODEL, CostModel
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig
from tests.commands import Pglog, assert_one_clear_line
from tests.writers.small_source import write_log


def run_commands(run: Path, output: Path) -> list[list[object]]:
    return [
        ["evaluate", run],
        ["export", run, "mesh", "-o", output],
        ["diff", run, run],
    ]


def test_what_is_no_run(pglog: Pglog, tmp_path: Path, small_log: Path) -> None:
    output = tmp_path / "a.ply"
    for command in run_commands(tmp_path / "no", output):
        assert_one_clear_line(pglog(*command), "no: no such run; check the path")
    for command in run_commands(tmp_path, output):
        assert_one_clear_line(pglog(*command), "is not a finished run; make one with `pglog replay")
    for command in run_commands(small_log, output):
        assert_one_clear_line(pglog(*command), "no such run")
    model = CostModel.load(DEFAULT_MODEL)
    manifest = Manifest.of(small_log, ReplayConfig(), model, "cpu", None)
    manifest.write(tmp_path / "manifest.json")
    finish = f"finish it with `pglog replay {small_log} -o {tmp_path} --resume`"
    for command in run_commands(tmp_path, output):
        assert_one_clear_line(pglog(*command), f"is not a finished run; {finish}")
    assert_one_clear_line(pglog("view", tmp_path), "the folder has no telemetry.rrd")
    assert not output.exists()


def test_an_unknown_export(pglog: Pglog, tmp_path: Path) -> None:
    answer = pglog("export", tmp_path, "stl", "-o", tmp_path / "a.stl")
    assert (answer.code, answer.out) == (2, "")
    assert "'stl'" in answer.err
    assert "'mesh', 'points'" in answer.err


def test_an_export_that_exists(pglog: Pglog, tmp_path: Path) -> None:
    output = tmp_path / "a.ply"
    output.touch()
    answer = pglog("export", tmp_path, "mesh", "-o", output)
    assert_one_clear_line(answer, "a.ply: the output exists")


def test_wrong_options_of_replay(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    for options, part in (
        (["--threads", 0], "0 threads cannot compute; use 1 or more"),
        (["--start", 9], "a recording of 5 frames: start 9"),
        (["--resume"], "there is no run to resume"),
    ):
        assert_one_clear_line(pglog("replay", small_log, "-o", run, *options), part)
        assert not run.exists()


def test_an_unknown_device(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    answer = pglog("replay", small_log, "-o", tmp_path / "run", "--device", "tpu")
    assert (answer.code, answer.out) == (2, "")
    assert "'tpu'" in answer.err
    assert "('auto', 'cpu', 'cuda')" in answer.err


@pytest.mark.long
def test_a_log_is_mapped_judged_exported_and_compared(
    pglog: Pglog, room_log: Path, tmp_path: Path
) -> None:
    runs = [tmp_path / "one", tmp_path / "two"]
    options = ["--steps", 4, "--stop", 5, "--hold-out-every", 4]
    for run, seed in zip(runs, (0, 1), strict=True):
        answer = pglog("replay", room_log, "-o", run, *options, "--seed", seed)
        assert answer.code == 0
        assert "5/5" in answer.err
        assert re.search(r"frames mapped +│ 4 ", answer.out)
    assert_one_clear_line(pglog("replay", room_log, "-o", runs[0]), "the output exists")
    answer = pglog("evaluate", runs[0], "--json", "--voxel-m", 0.2)
    assert answer.code == 0
    assert json.loads(answer.out)["scores"]["views"] == 1
    mesh = tmp_path / "a.ply"
    answer = pglog("export", runs[0], "mesh", "-o", mesh, "--voxel-m", 0.2)
    assert answer.code == 0
    assert re.fullmatch(rf"{re.escape(str(mesh))}: \d+ vertices, \d+ faces\n", answer.out)
    same, other = pglog("diff", runs[0], runs[0]), pglog("diff", *runs)
    assert (same.code, same.out) == (0, "the runs are equal, bit for bit\n")
    assert other.code == 1
    assert "config.seed: 0 | 1" in other.out
    assert "first difference: " in other.out
    moved = tmp_path / "moved.mcap"
    write_log(moved)
    answer = pglog("evaluate", runs[0], "--log", moved)
    assert_one_clear_line(answer, "moved.mcap: is not the log that the run was made of")
