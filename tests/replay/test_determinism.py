"""The contract of replay: the same ledger bit for bit, however it comes about."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import bits_float, read_ledger
from proground_log.run.settings import ReplayConfig, TelemetryConfig
from recorders.record import record
from recorders.room import RoomSource
from replay.divergence.diff import compare_runs
from replay.session import ReplayStoppedError, replay
from tests.full_disk import largest_file
from tests.replay.golden import CASES, SMALL, golden_path, machine, replay_case
from tests.replay.small_replay import SMALL_FLAGS, StopAfter, ledger_bytes, replay_with_threads

SLOW = pytest.mark.slow


@pytest.fixture(scope="module")
def reference_run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("reference") / "run"
    replay(room_log, run, SMALL)
    return run


def test_twice_is_the_same(room_log: Path, reference_run: Path, tmp_path: Path) -> None:
    replay(room_log, tmp_path / "run", SMALL)
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(reference_run)
    maps = [RunFolder(run).map.read_bytes() for run in (reference_run, tmp_path / "run")]
    assert maps[0] == maps[1]
    assert compare_runs(reference_run, tmp_path / "run").is_same


@SLOW
def test_telemetry_does_not_touch_the_map(
    room_log: Path, reference_run: Path, tmp_path: Path
) -> None:
    replay(room_log, tmp_path / "run", replace(SMALL, telemetry=TelemetryConfig(enabled=False)))
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(reference_run)
    assert not RunFolder(tmp_path / "run").telemetry.exists()


@SLOW
@pytest.mark.parametrize("threads", [1, 2, 4])
def test_any_number_of_threads_gives_the_same_ledger(
    room_log: Path, reference_run: Path, tmp_path: Path, threads: int
) -> None:
    replay_with_threads(room_log, tmp_path / "run", threads)
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(reference_run)


@pytest.mark.parametrize("stops", [[4], *(pytest.param(s, marks=SLOW) for s in ([1], [3, 5]))])
def test_stopped_by_ctrl_c_and_resumed_gives_the_same_ledger(
    room_log: Path, reference_run: Path, tmp_path: Path, stops: list[int]
) -> None:
    run = tmp_path / "run"
    for number, frames in enumerate(stops):
        with pytest.raises(ReplayStoppedError, match="--resume"):
            replay(
                room_log,
                run,
                SMALL,
                resume=number > 0,
                watchers=lambda _, frames=frames: [StopAfter(frames)],  # type: ignore[misc]
            )
        assert not RunFolder(run).is_finished
    replay(room_log, run, ReplayConfig(), resume=True)
    assert ledger_bytes(run) == ledger_bytes(reference_run)
    assert RunFolder(run).map.read_bytes() == RunFolder(reference_run).map.read_bytes()
    names = sorted(path.name for path in run.iterdir())
    assert names == ["ledger.jsonl", "manifest.json", "map.safetensors", "telemetry.rrd"]


@SLOW
def test_killed_and_resumed_gives_the_same_ledger(
    room_log: Path, reference_run: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    command = [sys.executable, "-m", "pglog", "replay", str(room_log), "-o", str(run)]
    process = subprocess.Popen([*command, *SMALL_FLAGS], stderr=subprocess.DEVNULL)
    checkpoint = RunFolder(run).checkpoint
    while not checkpoint.is_file() and process.poll() is None:
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not RunFolder(run).is_finished
    replay(room_log, run, ReplayConfig(), resume=True)
    assert ledger_bytes(run) == ledger_bytes(reference_run)


@SLOW
@pytest.mark.parametrize("room_bytes", [20_000, 150_000, 400_000])
def test_a_full_disk_is_named_and_the_run_goes_on_when_there_is_room(
    room_log: Path, reference_run: Path, tmp_path: Path, room_bytes: int
) -> None:
    """Whichever of the run's files meets the limit first."""
    run = tmp_path / "run"
    with (
        largest_file(room_bytes),
        pytest.raises(ProgroundError, match=r"cannot write: .*elsewhere"),
    ):
        replay(room_log, run, SMALL)
    finals = [RunFolder(run).ledger, RunFolder(run).map, RunFolder(run).telemetry]
    assert not any(path.exists() for path in finals)
    replay(room_log, run, ReplayConfig(), resume=True)
    assert ledger_bytes(run) == ledger_bytes(reference_run)


@SLOW
def test_another_seed_differs_from_the_first_step(
    room_log: Path, reference_run: Path, tmp_path: Path
) -> None:
    replay(room_log, tmp_path / "run", replace(SMALL, seed=1))
    comparison = compare_runs(reference_run, tmp_path / "run")
    assert not comparison.is_same
    assert comparison.origins == ["config.seed: 0 | 1"]
    divergence = comparison.divergence
    assert divergence is not None
    assert (divergence.frame, divergence.step) == (0, 0)
    assert divergence.cause == "random draw"
    assert any("ulp" in detail for detail in divergence.details)
    assert "table" in comparison.tensors


@SLOW
def test_diff_names_the_first_step_and_the_loss(
    room_log: Path, reference_run: Path, tmp_path: Path
) -> None:
    """A weight that differs changes the total at once, each term only a step later."""
    weights = replace(SMALL.mapper.weights, sdf=201.0)
    config = replace(SMALL, mapper=replace(SMALL.mapper, weights=weights))
    replay(room_log, tmp_path / "run", config)
    comparison = compare_runs(reference_run, tmp_path / "run")
    assert comparison.origins == ["config.mapper.weights.sdf: 200.0 | 201.0"]
    divergence = comparison.divergence
    assert divergence is not None
    assert (divergence.step, divergence.cause) == (0, "loss")
    assert [detail.split(":")[0] for detail in divergence.details] == ["loss total"]


@SLOW
def test_diff_names_a_frame_that_is_missing(
    room_log: Path, reference_run: Path, tmp_path: Path
) -> None:
    replay(room_log, tmp_path / "run", replace(SMALL, max_frames=6))
    divergence = compare_runs(reference_run, tmp_path / "run").divergence
    assert divergence is not None
    assert (divergence.frame, divergence.cause) == (6, "schedule")


def test_the_ledger_tells_when_it_was_changed(reference_run: Path, tmp_path: Path) -> None:
    lines = RunFolder(reference_run).ledger.read_text().splitlines()
    entry = json.loads(lines[5])
    entry["frame"] += 1
    lines[5] = json.dumps(entry, separators=(",", ":"))
    changed = tmp_path / "ledger.jsonl"
    changed.write_text("\n".join(lines) + "\n")
    with pytest.raises(ProgroundError, match="line 7"):
        list(read_ledger(changed))


@pytest.mark.parametrize("line", [b"[1]", b"7", b"\xff\xfe", b"{"])
def test_what_is_no_ledger_is_named(tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "ledger.jsonl"
    path.write_bytes(line + b"\n")
    with pytest.raises(ProgroundError, match="line 1"):
        list(read_ledger(path))


def test_the_ledger_has_everything(reference_run: Path) -> None:
    entries = list(read_ledger(RunFolder(reference_run).ledger))
    frames = [entry for entry in entries if entry["event"] == "frame"]
    steps = [entry for entry in entries if entry["event"] == "step"]
    assert [entry["frame"] for entry in frames] == list(range(12))
    assert [entry["frame"] for entry in frames if entry["held_out"]] == [4, 9]
    assert [entry["step"] for entry in steps] == list(range(30))
    assert {entry["frame"] for entry in steps} == {0, 1, 2, 3, 5, 6, 7, 8, 10, 11}
    for entry in steps:
        assert set(entry["losses"]) >= {"rgb", "depth", "sdf", "free_space", "smoothness", "total"}
        assert len(entry["draws"]) == 64
    states = [entry for entry in entries if entry["event"] == "state"]
    assert [entry["step"] for entry in states] == [4, 8, 12, 16, 20, 24, 28, 30]
    parts = {name.split("/")[0] for name in states[-1]["digests"]}
    assert parts == {"field", "averaged", "optimiser", "buffer", "observed", "steps"}


def test_selection_of_frames(room_log: Path, tmp_path: Path) -> None:
    config = ReplayConfig(
        steps=1,
        selection=Selection(start=1, stop=9, stride=3),
        max_frames=2,
        mapper=SMALL.mapper,
        telemetry=TelemetryConfig(enabled=False),
    )
    manifest = replay(room_log, tmp_path / "run", config)
    entries = list(read_ledger(RunFolder(tmp_path / "run").ledger))
    assert [e["frame"] for e in entries if e["event"] == "frame"] == [1, 4]
    assert manifest.result is not None
    assert manifest.result["frames mapped"] == 2


def other_log(path: Path) -> Path:
    source = RoomSource(seed=1, frames=2)
    record(source, "another room", path, Selection(), overwrite=False, progress=lambda *_: None)
    return path


@SLOW
def test_resume_refuses_another_log_and_other_options(room_log: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(ReplayStoppedError):
        replay(room_log, run, SMALL, watchers=lambda _: [StopAfter(2)])
    with pytest.raises(ProgroundError, match="settings are not what the run was started with"):
        replay(room_log, run, ReplayConfig(steps=7), resume=True)
    with pytest.raises(ProgroundError, match="log is not what"):
        replay(other_log(tmp_path / "other.mcap"), run, ReplayConfig(), resume=True)
    moved = tmp_path / "moved.mcap"
    moved.write_bytes(room_log.read_bytes())
    replay(moved, run, ReplayConfig(), resume=True)
    with pytest.raises(ProgroundError, match="no run to resume"):
        replay(room_log, tmp_path / "nothing", ReplayConfig(), resume=True)


@pytest.mark.parametrize("name", CASES)
def test_the_built_in_room_gives_the_golden_ledger(
    room_log: Path, tmp_path: Path, name: str
) -> None:
    golden = json.loads(golden_path(name).read_text())
    entries = replay_case(name, room_log, tmp_path / "run")
    if golden["machine"] == machine():
        assert golden["ledger"] == entries
        return
    # The schedule is arithmetic, and the same on every machine; losses are close.
    exact = ("scheduled", "dropped", "regions")
    assert [e for e in entries if e["event"] in exact] == [
        e for e in golden["ledger"] if e["event"] in exact
    ]
    found = [e["losses"] for e in entries if e["event"] == "step"]
    expected = [e["losses"] for e in golden["ledger"] if e["event"] == "step"]
    for step, (a, b) in enumerate(zip(found, expected, strict=True)):
        for term in ("rgb", "sdf", "free_space"):
            assert bits_float(a[term]) == pytest.approx(bits_float(b[term]), rel=0.05), (step, term)
