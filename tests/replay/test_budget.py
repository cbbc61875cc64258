"""Replays under a budget: what the schedule says is what is done, however the run comes about."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.log.reader import LogReader
from proground_log.run.cost_model import CostModel
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig, TelemetryConfig
from recorders.record import record
from recorders.room import RoomSource
from replay.plan import Plan
from replay.session import ReplayStoppedError, cost_model_of, replay
from tests.commands import Pglog
from tests.replay.golden import CASES, COST, SMALL, perceiver_of, under

pytestmark = pytest.mark.slow

QUIET = TelemetryConfig(enabled=False)
OVERLOADED = replace(CASES["drop_oldest"], telemetry=QUIET)
BESIDE = replace(
    CASES["perceived_beside"], telemetry=QUIET, checkpoint_every=1, keep_checkpoints=True
)


@pytest.fixture(scope="module")
def overloaded(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("overloaded") / "run"
    replay(room_log, run, replace(OVERLOADED, keep_checkpoints=True, checkpoint_every=2))
    return run


@pytest.fixture(scope="module")
def beside(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("beside") / "run"
    replay(room_log, run, BESIDE, perceiver=perceiver_of(room_log))
    return run


def entries_of(run: Path, *events: str) -> list[dict[str, Any]]:
    ledger = read_ledger(RunFolder(run).ledger)
    return [entry for entry in ledger if not events or entry["event"] in events]


def ledger_bytes(run: Path) -> bytes:
    return RunFolder(run).ledger.read_bytes()


def test_every_frame_is_mapped_dropped_or_held_out(room_log: Path, overloaded: Path) -> None:
    frames = entries_of(overloaded, "frame")
    dropped = [entry["frame"] for entry in entries_of(overloaded, "dropped")]
    mapped = [entry["frame"] for entry in frames if not entry["held_out"]]
    held_out = [entry["frame"] for entry in frames if entry["held_out"]]
    assert held_out == [4, 9]
    assert dropped
    assert sorted(mapped + dropped + held_out) == list(range(len(LogReader(room_log))))
    steps = Counter(entry["frame"] for entry in entries_of(overloaded, "step"))
    # 60 ms less 9 for decoding and inserting, at 18.704 ms a step.
    assert steps == dict.fromkeys(mapped, 2)


def test_the_ledger_keeps_time(overloaded: Path) -> None:
    times = [entry["sim_time_ns"] for entry in entries_of(overloaded) if "sim_time_ns" in entry]
    assert times == sorted(times)
    scheduled = entries_of(overloaded, "scheduled")
    now_ns = 0
    for entry in scheduled:
        spans = list(entry["spans"].values())
        assert spans[0][0] == now_ns + entry["idle_ns"]
        assert [begin for begin, _ in spans[1:]] == [end for _, end in spans[:-1]]
        assert spans[-1][1] == entry["sim_time_ns"]
        now_ns = entry["sim_time_ns"]
    last_steps = {e["frame"]: e["sim_time_ns"] for e in entries_of(overloaded, "step")}
    assert last_steps == {e["frame"]: e["sim_time_ns"] for e in scheduled}


def test_the_report_agrees_with_the_ledger(overloaded: Path) -> None:
    result = Manifest.read(RunFolder(overloaded).manifest).result
    assert result is not None
    report: Any = result["simulation"]
    scheduled, dropped = entries_of(overloaded, "scheduled"), entries_of(overloaded, "dropped")
    assert report["frames mapped"] == len(scheduled)
    assert report["frames dropped"] == len(dropped)
    assert report[f"dropped, {dropped[0]['reason']}"] == len(dropped)
    assert report["steps"] == len(entries_of(overloaded, "step")) == result["steps"]
    lags = [entry["sim_time_ns"] - entry["arrived_ns"] for entry in scheduled]
    assert report["worst lag s"] == pytest.approx(max(lags) / 1e9, abs=1e-4)
    assert report["mean lag s"] == pytest.approx(sum(lags) / len(lags) / 1e9, abs=1e-4)
    spent = sum(report[f"{stage} s"] for stage in ("decode", "insert", "step"))
    assert spent + report["idle s"] == pytest.approx(report["elapsed s"], abs=0.003)
    assert report["elapsed s"] == pytest.approx(scheduled[-1]["sim_time_ns"] / 1e9, abs=1e-3)
    assert result["frames arrived"] == 12


def test_a_slower_machine_has_no_time_for_a_step(room_log: Path, tmp_path: Path) -> None:
    simulation = replace(OVERLOADED.simulation, cost_scale=4.0)
    replay(room_log, tmp_path / "run", replace(OVERLOADED, simulation=simulation))
    slow = entries_of(tmp_path / "run", "scheduled")
    assert len(slow) > 3
    assert all(entry["steps"] == 0 for entry in slow)
    assert not entries_of(tmp_path / "run", "step")
    assert all(e["spans"]["decode"][1] - e["spans"]["decode"][0] == 20_000_000 for e in slow)


@pytest.mark.parametrize(
    ("settings", "perceives", "least_ms"),
    [
        # 5 ms to decode, 4 to insert and 18.704 a step; the figure is a whole number.
        ({}, False, 28),
        ({"cost_scale": 4.0}, False, 111),
        # 50 to perceive, 1 to learn and 2 more a step.
        ({}, True, 101),
        ({"perceive_every": 2}, True, 30),
    ],
)
def test_a_budget_without_a_step_is_warned_of_with_the_least_that_has_one(
    room_log: Path, settings: dict[str, Any], perceives: bool, least_ms: int
) -> None:
    reader = LogReader(room_log)

    def plan_of(budget_ms: float) -> Plan:
        config = under(budget_ms=budget_ms, **settings)
        return Plan(reader, config, cost_model_of(config), learns=perceives)

    warning = plan_of(least_ms - 1).warning()
    assert warning is not None
    assert warning.startswith(f"--budget-ms {least_ms - 1}: no step fits (one takes ")
    assert warning.endswith(f"the map will learn nothing; give {least_ms} or more")
    enough = plan_of(least_ms)
    assert enough.warning() is None
    assert any(turn.slot.steps for turn in enough.turns() if turn.slot is not None)


def test_without_a_budget_there_is_nothing_to_warn_of(room_log: Path) -> None:
    config = replace(SMALL, steps=0)
    assert Plan(LogReader(room_log), config, cost_model_of(config), learns=False).warning() is None


def test_the_command_warns_before_and_after(room_log: Path, tmp_path: Path, pglog: Pglog) -> None:
    run = tmp_path / "run"
    flags = ["--telemetry.no-enabled", "--mapper.sampling.rays", 64, "--max-frames", 2]
    answer = pglog("replay", room_log, "-o", run, *flags, "--budget-ms", 5)
    assert answer.code == 0
    before, after = (line for line in answer.err.splitlines() if "warning" in line)
    assert re.fullmatch(
        r"pglog: warning: --budget-ms 5: no step fits \(one takes 12.4 ms by epyc-2-threads, "
        r"reading and inserting 9.1 ms\); the map will learn nothing; give 22 or more",
        before,
    )
    assert after == f"pglog: warning: {run}: no step was done; the map has learnt nothing"
    assert answer.err.index(before) < answer.err.index("2/2") < answer.err.index(after)
    enough = pglog("replay", room_log, "-o", tmp_path / "enough", *flags, "--budget-ms", 22)
    assert (enough.code, "warning" in enough.err) == (0, False)


def test_any_checkpoint_goes_on_to_the_same_ledger(
    room_log: Path, overloaded: Path, tmp_path: Path
) -> None:
    kept = RunFolder(overloaded).kept_checkpoints()
    assert list(kept) == [2, 4, 6, 8, 10]
    for frames, checkpoint in kept.items():
        run = tmp_path / str(frames)
        replay(room_log, run, OVERLOADED, start=checkpoint)
        assert ledger_bytes(run) == ledger_bytes(overloaded)
        assert RunFolder(run).map.read_bytes() == RunFolder(overloaded).map.read_bytes()


def test_a_checkpoint_brings_its_settings_and_takes_no_others(
    room_log: Path, overloaded: Path, tmp_path: Path
) -> None:
    checkpoint = RunFolder(overloaded).kept_checkpoints()[4]
    run = tmp_path / "run"
    replay(room_log, run, ReplayConfig(), start=checkpoint)
    assert ledger_bytes(run) == ledger_bytes(overloaded)
    before = {path: path.read_bytes() for path in overloaded.iterdir() if path.is_file()}
    other = record_another_room(tmp_path / "other.mcap")
    wrong: list[tuple[Path, Path, ReplayConfig, str]] = [
        (other, tmp_path / "a", OVERLOADED, "another log"),
        (room_log, tmp_path / "b", replace(OVERLOADED, seed=1), "other settings"),
        (room_log, overloaded, OVERLOADED, "name another folder"),
    ]
    for log, output, config, message in wrong:
        with pytest.raises(ProgroundError, match=message):
            replay(log, output, config, start=checkpoint, overwrite=True)
        assert output == overloaded or not output.exists()
    assert before == {path: path.read_bytes() for path in overloaded.iterdir() if path.is_file()}


def record_another_room(path: Path) -> Path:
    source = RoomSource(seed=1, frames=12)
    record(source, "another room", path, Selection(), overwrite=False, progress=lambda *_: None)
    return path


def test_until_a_frame_and_on(room_log: Path, overloaded: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(ReplayStoppedError, match="after frame 4") as stop:
        replay(room_log, run, OVERLOADED, until_frame=4)
    assert not stop.value.is_interruption
    replay(room_log, run, ReplayConfig(), resume=True)
    assert ledger_bytes(run) == ledger_bytes(overloaded)


class PauseEach:
    """Pauses after every frame; stops at some."""

    def __init__(self, stop_at: int | None = None) -> None:
        self.asked: list[int] = []
        self._stop_at = stop_at

    def wants(self, frame: int) -> bool:
        return frame != 3

    def go_on(self, frame: int) -> bool:
        self.asked.append(frame)
        return frame != self._stop_at


def test_a_pause_changes_nothing_and_may_stop(
    room_log: Path, overloaded: Path, tmp_path: Path
) -> None:
    pause = PauseEach()
    replay(room_log, tmp_path / "run", OVERLOADED, pause=pause)
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(overloaded)
    frames = [entry["frame"] for entry in entries_of(overloaded, "frame")]
    assert pause.asked == [frame for frame in frames[:-1] if frame != 3]
    with pytest.raises(ReplayStoppedError):
        replay(room_log, tmp_path / "stopped", OVERLOADED, pause=PauseEach(frames[1]))


def test_pausing_at_the_terminal(room_log: Path, tmp_path: Path) -> None:
    """After frame 0 to the next, after frame 1 on, after frame 5 the input ends: stop."""
    config = ["--steps", "1", "--telemetry.no-enabled", "--mapper.sampling.rays", "64"]
    command = [sys.executable, "-m", "pglog", "replay", str(room_log)]
    answer = subprocess.run(
        [*command, "-o", str(tmp_path / "run"), *config, "--pause-at", "0", "5"],
        input="n\nwhat\n\n",
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    asked = [line for line in answer.stderr.splitlines() if "paused after frame" in line]
    assert [line.split(":")[0].split()[-1] for line in asked] == ["0", "1", "1", "5"]
    assert "stopped after frame 5" in answer.stderr
    assert RunFolder(tmp_path / "run").checkpoint.is_file()


def test_regions_come_late_where_perception_runs_beside(beside: Path) -> None:
    arrived = entries_of(beside, "regions")
    scheduled = {entry["frame"]: entry for entry in entries_of(beside, "scheduled")}
    assert arrived
    assert all("perceive" not in entry["spans"] for entry in scheduled.values())
    for entry in arrived:
        assert entry["begin_ns"] >= scheduled[entry["frame"]]["spans"]["decode"][1]
        assert entry["sim_time_ns"] - entry["begin_ns"] == 70_000_000
    first = arrived[0]["sim_time_ns"]
    for step in entries_of(beside, "step"):
        assert ("semantic" in step["losses"]) == (step["sim_time_ns"] - first > 20_704_000 - 1)


def test_regions_under_way_survive_a_stop(room_log: Path, beside: Path, tmp_path: Path) -> None:
    kept = RunFolder(beside).kept_checkpoints()
    assert len(kept) >= 6
    for frames, checkpoint in kept.items():
        run = tmp_path / str(frames)
        replay(room_log, run, BESIDE, start=checkpoint, perceiver=perceiver_of(room_log))
        assert ledger_bytes(run) == ledger_bytes(beside), frames


def test_only_some_frames_are_perceived(room_log: Path, tmp_path: Path) -> None:
    config = replace(
        under(perceive_keyframes_only=True, keyframe_every=3), steps=1, hold_out_every=0
    )
    perceiver = perceiver_of(room_log)
    replay(room_log, tmp_path / "run", replace(config, telemetry=QUIET), perceiver=perceiver)
    scheduled = entries_of(tmp_path / "run", "scheduled")
    perceived = [entry["frame"] for entry in scheduled if "perceive" in entry["spans"]]
    assert perceived == [0, 3, 6, 9]
    samples = [e["semantics"]["inserted"] for e in entries_of(tmp_path / "run", "done")]
    grew = [n for n, (a, b) in enumerate(zip([0, *samples], samples, strict=False)) if b > a]
    assert grew == [0, 3, 6, 9]


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_the_machine_and_its_load_do_not_matter(
    room_log: Path, overloaded: Path, tmp_path: Path, threads: int
) -> None:
    """While the other core burns."""
    burn = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        code = (
            "import sys, torch; from pathlib import Path; torch.set_num_threads(int(sys.argv[3]));"
            "from replay.session import replay; from tests.replay.test_budget import OVERLOADED;"
            "replay(Path(sys.argv[1]), Path(sys.argv[2]), OVERLOADED)"
        )
        count = str(threads)
        subprocess.run(
            [sys.executable, "-c", code, str(room_log), str(tmp_path / "run"), count],
            env={**os.environ, "NUMBA_NUM_THREADS": count, "OMP_NUM_THREADS": count},
            cwd=Path(__file__).parents[2],
            check=True,
        )
    finally:
        burn.kill()
        burn.wait()
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(overloaded)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"budget_ms": 0.0}, "--budget-ms: cannot be 0"),
        ({"budget_ms": -5.0}, "--budget-ms: cannot be -5"),
        ({"budget_ms": float("nan")}, "--budget-ms: cannot be nan"),
        ({"rate": -1.0}, "--rate: cannot be -1"),
        ({"queue": 0}, "--queue: cannot be 0"),
        ({"keyframe_every": 0}, "--keyframe-every: cannot be 0"),
        ({"perceive_every": 0}, "--perceive-every: cannot be 0"),
        ({"cost_scale": 0.0}, "--cost-scale: a machine cannot be 0"),
        ({"cost": "no-such-machine"}, "no-such-machine"),
    ],
)
def test_a_setting_without_sense_is_refused_before_any_work(
    room_log: Path, tmp_path: Path, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ProgroundError, match=message):
        replay(room_log, tmp_path / "run", under(**settings))
    assert not (tmp_path / "run").exists()


def without(stage: str, path: Path) -> str:
    content = json.loads(Path(COST).read_text())
    del content["stages"][stage]
    path.write_text(json.dumps(content))
    return str(path)


@pytest.mark.parametrize("name", ["steps", "digest_every", "checkpoint_every"])
def test_a_count_below_its_least_is_refused(room_log: Path, tmp_path: Path, name: str) -> None:
    config = ReplayConfig(**{name: -1})  # type: ignore[arg-type]
    with pytest.raises(ProgroundError, match=f"--{name.replace('_', '-')}: cannot be -1"):
        replay(room_log, tmp_path / "run", config)
    assert not (tmp_path / "run").exists()


OF_PERCEPTION = ("perceive", "semantic_insert", "semantic_step")


@pytest.mark.parametrize("stage", ["decode", "insert", "step", *OF_PERCEPTION])
def test_a_cost_model_without_a_stage_is_refused_where_it_is_needed(
    room_log: Path, tmp_path: Path, stage: str
) -> None:
    config = under(cost=without(stage, tmp_path / "cost.json"), budget_ms=50.0)
    with pytest.raises(ProgroundError, match=f"has no cost of {stage}"):
        replay(room_log, tmp_path / "run", config, perceiver=perceiver_of(room_log))
    assert not (tmp_path / "run").exists()
    if stage in OF_PERCEPTION:
        model = CostModel.load(config.simulation.cost)
        assert list(Plan(LogReader(room_log), config, model, learns=False).turns())


def test_a_manifest_whose_log_has_changed_is_refused(
    room_log: Path, overloaded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from pglog.commands import main

    changed = tmp_path / "changed.mcap"
    changed.write_bytes(room_log.read_bytes() + b"\0")
    manifest = str(RunFolder(overloaded).manifest)
    for log, code in ((changed, 2), (room_log, 0)):
        arguments = ["replay", str(log), "-o", str(tmp_path / "again"), "--manifest", manifest]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["pglog", *arguments, "--check"])
            with pytest.raises(SystemExit) as stop:
                main()
        assert stop.value.code == code, capsys.readouterr()
