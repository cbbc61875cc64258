"""Telling runs apart: every difference that there can be, made on purpose, is found and named."""

from __future__ import annotations

import json
import shutil
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pglog.commands import main
from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import bits_float, read_ledger
from proground_log.run.settings import SimulationConfig
from recorders.record import record
from recorders.room import RoomSource
from replay.divergence.diff import compare_all, compare_runs
from replay.divergence.distance import tensor_differences, ulp_distance
from replay.divergence.divergence import first_divergence
from replay.session import replay
from tests.replay.divergence.ledger_edits import Entry, edited_run, without_frame
from tests.replay.golden import COST, SMALL

pytestmark = pytest.mark.slow

TINY = replace(SMALL, max_frames=7, telemetry=replace(SMALL.telemetry, enabled=False))
ROOM_FRAMES = 12


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("diff") / "run"
    replay(room_log, path, TINY)
    return path


def changed(
    event: str, number: int, change: Callable[[Entry], None]
) -> Callable[[list[Entry]], list[Entry]]:
    """An edit of one line: the n-th of a kind of event."""

    def edit(entries: list[Entry]) -> list[Entry]:
        change([entry for entry in entries if entry["event"] == event][number])
        return entries

    return edit


def moved(bits: str, ulp: int) -> str:
    """The float32 so many values further up."""
    return f"{int(bits, 16) + ulp:08x}"


def move_loss(term: str, ulp: int) -> Callable[[Entry], None]:
    def move(entry: Entry) -> None:
        entry["losses"][term] = moved(entry["losses"][term], ulp)

    return move


@pytest.mark.parametrize(
    ("event", "change", "cause", "detail"),
    [
        ("frame", {"input": "0" * 64}, "input", "input: "),
        ("frame", {"stamp_ns": 5}, "input", "stamp_ns: "),
        ("frame", {"held_out": True}, "schedule", "held_out: False | True"),
        ("step", {"iteration": 9}, "schedule", "iteration: 0 | 9"),
        ("step", {"sim_time_ns": 1}, "schedule", "sim_time_ns: "),
        ("scheduled", {"waiting": 4}, "schedule", "waiting: 0 | 4"),
        ("scheduled", {"overrun_ns": 4}, "schedule", "overrun_ns: 0 | 4"),
        ("done", {"steps": 2}, "schedule", "steps: 3 | 2"),
        ("step", {"draws": "f" * 64}, "random draw", "draws: "),
        ("keyframe", {"evicted": 11}, "buffer", "evicted: 0 | 11"),
        ("done", {"semantics": {}}, "buffer", "semantics: None | {}"),
    ],
)
def test_a_field_that_differs_is_named(
    run: Path, tmp_path: Path, event: str, change: Entry, cause: str, detail: str
) -> None:
    number = 0 if event == "keyframe" else 2
    other = edited_run(run, tmp_path / "other", changed(event, number, lambda e: e.update(change)))
    lines = list(read_ledger(RunFolder(run).ledger))
    entry = [e for e in lines if e["event"] == event][number]
    divergence = compare_runs(run, other).divergence
    assert divergence is not None
    if event == "step":
        number = entry["iteration"]
        detail = detail.replace("iteration: 0", f"iteration: {number}")
    assert divergence.cause == cause
    assert divergence.line == lines.index(entry) + 1
    assert divergence.frame == entry["frame"]
    assert len(divergence.details) == 1
    assert divergence.details[0].startswith(detail)


def test_which_loss_and_how_far(run: Path, tmp_path: Path) -> None:
    other = edited_run(run, tmp_path / "other", changed("step", 4, move_loss("sdf", 3)))
    divergence = compare_runs(run, other).divergence
    assert divergence is not None
    assert (divergence.frame, divergence.step, divergence.cause) == (1, 4, "loss")
    [detail] = divergence.details
    assert detail.startswith("loss sdf: ")
    assert detail.endswith("(3 ulp)")


def test_a_loss_that_only_one_run_has(run: Path, tmp_path: Path) -> None:
    edit = changed("step", 4, lambda entry: entry["losses"].pop("rgb"))
    divergence = compare_runs(run, edited_run(run, tmp_path / "other", edit)).divergence
    assert divergence is not None
    assert divergence.cause == "loss"
    assert divergence.details[0].endswith("| absent")


def test_which_tensor_after_which_step(run: Path, tmp_path: Path) -> None:
    name = "optimiser/0/exp_avg"
    edit = changed("state", 1, lambda entry: entry["digests"].update({name: "0"}))
    divergence = compare_runs(run, edited_run(run, tmp_path / "other", edit)).divergence
    assert divergence is not None
    assert (divergence.cause, divergence.step) == ("state", 7)
    assert [detail.split(":")[0] for detail in divergence.details] == [f"tensor {name}"]


def test_the_first_difference_is_the_one_that_is_told(run: Path, tmp_path: Path) -> None:
    def edit(entries: list[Entry]) -> list[Entry]:
        entries = changed("step", 9, move_loss("rgb", 1))(entries)
        return changed("step", 3, move_loss("depth", 1))(entries)

    divergence = compare_runs(run, edited_run(run, tmp_path / "other", edit)).divergence
    assert divergence is not None
    assert divergence.step == 3


def test_a_dropped_frame(run: Path, tmp_path: Path) -> None:
    other = edited_run(run, tmp_path / "other", lambda entries: list(without_frame(entries, 3)))
    divergence = compare_runs(run, other).divergence
    assert divergence is not None
    assert (divergence.frame, divergence.step, divergence.cause) == (3, 8, "schedule")
    assert divergence.details == [
        "first: event frame, frame 3",
        "second: event dropped, frame 3, reason drop-oldest",
    ]


def test_a_run_that_ends_early(run: Path, tmp_path: Path) -> None:
    shorter = edited_run(run, tmp_path / "shorter", lambda entries: entries[:-2])
    for pair, whose in (((run, shorter), "second"), ((shorter, run), "first")):
        divergence = compare_runs(*pair).divergence
        assert divergence is not None
        assert divergence.cause == "schedule"
        assert f"{whose}: the run ends here" in divergence.details


def test_other_intervals_of_digests_are_no_difference(
    room_log: Path, run: Path, tmp_path: Path
) -> None:
    replay(room_log, tmp_path / "run", replace(TINY, digest_every=3))
    for pair in ((run, tmp_path / "run"), (tmp_path / "run", run)):
        comparison = compare_runs(*pair)
        assert comparison.is_same
        assert comparison.passed_over == []
    assert not compare_all(run, tmp_path / "run")


def test_another_cost_model_is_an_origin_and_changes_the_schedule(
    room_log: Path, tmp_path: Path
) -> None:
    for name, scale in (("a", 1.0), ("b", 1.5)):
        simulation = SimulationConfig(cost=COST, budget_ms=60.0, rate=0.0, cost_scale=scale)
        replay(room_log, tmp_path / name, replace(TINY, simulation=simulation, max_frames=2))
    comparison = compare_runs(tmp_path / "a", tmp_path / "b")
    assert "config.simulation.cost_scale: 1.0 | 1.5" in comparison.origins
    assert any(origin.startswith("cost_model.stages.step.") for origin in comparison.origins)
    divergence = comparison.divergence
    assert divergence is not None
    assert (divergence.frame, divergence.cause) == (0, "schedule")


def test_ledgers_of_other_versions_are_compared_as_far_as_both_go(
    run: Path, tmp_path: Path
) -> None:
    def foreign(entries: list[Entry]) -> list[Entry]:
        found: list[Entry] = []
        for entry in entries:
            if entry["event"] == "scheduled":  # An older version had none.
                continue
            if entry["event"] == "done":  # A newer one tells more.
                found.append({"event": "weather", "frame": entry["frame"], "rain": True})
                entry["buffer"]["colour"] = "red"
                del entry["semantics"]
            found.append(entry)
        return found

    other = edited_run(run, tmp_path / "other", foreign)
    manifest = json.loads(RunFolder(other).manifest.read_text())
    manifest |= {"manifest_version": 99, "weather": "fine"}
    del manifest["cost_model"]
    RunFolder(other).manifest.write_text(json.dumps(manifest))
    comparison = compare_runs(run, other)
    assert comparison.is_same
    assert set(comparison.passed_over) == {
        "event scheduled is only in the first",
        "event weather is only in the second",
        "done.buffer.colour is only in the second",
        "done.semantics is only in the first",
    }
    assert "weather: absent | fine" in comparison.origins
    assert any(origin.startswith("cost_model: ") for origin in comparison.origins)
    backwards = compare_runs(other, run)
    assert backwards.is_same
    assert "event weather is only in the first" in backwards.passed_over
    worse = edited_run(other, tmp_path / "worse", changed("step", 5, move_loss("rgb", 2)))
    divergence = compare_runs(run, worse).divergence
    assert divergence is not None
    assert (divergence.step, divergence.cause) == (5, "loss")


def test_an_event_that_only_one_version_writes_hides_no_difference_behind_it() -> None:
    done: Entry = {"event": "done", "frame": 0, "steps": 3}
    scheduled: Entry = {"event": "scheduled", "frame": 0, "waiting": 1}
    first: list[Entry] = [{"event": "weather", "frame": 0}, scheduled, done]
    other = [{**scheduled, "waiting": 2}, done]
    divergence, passed_over = first_divergence(first, other)
    assert divergence is not None
    assert (divergence.line, divergence.details) == (2, ["waiting: 1 | 2"])
    assert passed_over == ["event weather is only in the first"]
    divergence, _ = first_divergence(other, first)
    assert divergence is not None
    assert divergence.details == ["waiting: 2 | 1"]


def test_an_unknown_field_that_differs_is_a_difference(run: Path, tmp_path: Path) -> None:
    paths = [
        edited_run(
            run, tmp_path / mood, changed("step", 2, lambda e, mood=mood: e.update(mood=mood))
        )  # type: ignore[misc]
        for mood in ("gay", "sad")
    ]
    divergence = compare_runs(*paths).divergence
    assert divergence is not None
    assert (divergence.cause, divergence.details) == ("unknown field", ["mood: gay | sad"])


def test_all_counts_lines_and_keeps_the_largest_distance(run: Path, tmp_path: Path) -> None:
    def edit(entries: list[Entry]) -> list[Entry]:
        for number, ulp in ((4, 1), (7, 9), (8, 2)):
            changed("step", number, move_loss("sdf", ulp))(entries)
        changed("done", 3, lambda entry: entry["buffer"].update(samples=1))(entries)
        return changed("state", 1, lambda e: e["digests"].update({"field/table": "0"}))(entries)

    rows = compare_all(run, edited_run(run, tmp_path / "other", edit))
    found = {row.name: row for row in rows}
    assert list(found) == ["loss sdf", "tensor field/table", "buffer.samples"]
    loss = found["loss sdf"]
    assert (loss.lines, loss.frame, loss.step, loss.ulp) == (3, 1, 4, 9)
    tensor = found["tensor field/table"]
    assert (tensor.lines, tensor.frame, tensor.step, tensor.ulp) == (1, 2, 7, None)
    assert (found["buffer.samples"].frame, found["buffer.samples"].cause) == (3, "buffer")


def test_a_dropped_frame_does_not_make_all_after_it_differ(run: Path, tmp_path: Path) -> None:
    other = edited_run(run, tmp_path / "other", lambda entries: list(without_frame(entries, 3)))
    rows = compare_all(run, other)
    assert {(row.name, row.lines, row.frame) for row in rows if row.cause == "schedule"} == {
        ("event frame only in the first", 1, 3),
        ("event step only in the first", 3, 3),
        ("event done only in the first", 1, 3),
        ("event dropped only in the second", 1, 3),
    }
    assert {row.name for row in rows if row.cause != "schedule"} <= {
        "event scheduled only in the first"
    }


def test_final_tensors(room_log: Path, run: Path, tmp_path: Path) -> None:
    replay(room_log, tmp_path / "run", replace(TINY, steps=2))
    tensors = compare_runs(run, tmp_path / "run").tensors
    assert tensors["table"].first.startswith("int8")
    decoder = next(d for name, d in tensors.items() if "decoders" in name)
    assert decoder.distance is not None
    assert decoder.distance > 0
    assert str(decoder).endswith("ulp")


@given(st.floats(width=32, allow_nan=False), st.integers(0, 1000))
def test_ulp_counts_float32_values(start: float, count: int) -> None:
    value = np.float32(start)
    end = value
    for _ in range(count % 20):
        end = np.nextafter(end, np.float32(np.inf))
    steps = 0
    at = value
    while at != end:
        at, steps = np.nextafter(at, np.float32(np.inf)), steps + 1
    signs_differ = bool(np.signbit(value) != np.signbit(end))
    # -0 and +0 are two values; nextafter takes them for one.
    assert ulp_distance(value, end) - steps in ((0, 1) if signs_differ else (0,))


@given(st.integers(0, 2**16 - 1), st.integers(0, 2**16 - 1))
def test_a_distance_is_0_only_where_the_bits_are_equal(a: int, b: int) -> None:
    for kind in (np.float16, np.int16, np.uint16):
        x, y = (np.array([bits], np.uint16).view(kind) for bits in (a, b))
        assert (ulp_distance(x, y) == 0) == (a == b)
        assert ulp_distance(x, y) == ulp_distance(y, x)


def test_distance_of_tensors() -> None:
    a = np.array([1.0, -0.0, np.nan, 5.0], np.float32)
    b = a.copy()
    assert tensor_differences({"x": a}, {"x": b}) == {}
    b[0] = bits_float(moved(struct.pack(">f", 1.0).hex(), 12))
    b[1] = 0.0
    difference = tensor_differences({"x": a}, {"x": b})["x"]
    assert (difference.differing, difference.size, difference.distance) == (2, 4, 12)
    counts = tensor_differences({"n": np.array([-3])}, {"n": np.array([4])})["n"]
    assert counts.distance == 7
    shapes = tensor_differences({"x": a}, {"x": b[:2], "y": b})
    assert str(shapes["x"]) == "float32 [4] | float32 [2]"
    assert str(shapes["y"]) == "absent | float32 [4]"


def code_of(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """The exit code of pglog."""
    monkeypatch.setattr(sys, "argv", ["pglog", *(str(argument) for argument in arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_exit_codes_and_output(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert code_of(monkeypatch, "diff", run, run, "--all") == 0
    assert "equal, bit for bit" in capsys.readouterr().out
    other = edited_run(run, tmp_path / "other", changed("step", 4, move_loss("sdf", 3)))
    assert code_of(monkeypatch, "diff", run, other, "--all") == 1
    shown = capsys.readouterr().out
    assert "first difference: loss, at frame 1, step 4" in shown
    assert "nothing that made the runs differs" in shown
    assert "most ulp" in shown
    assert code_of(monkeypatch, "diff", run, other, "--all", "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert told["same"] is False
    assert told["divergence"]["step"] == 4
    assert told["all"][0]["ulp"] == 3


@pytest.mark.parametrize("fault", ["no run", "unfinished", "no manifest", "ledger", "map"])
def test_what_cannot_be_compared_has_exit_code_2(
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    fault: str,
) -> None:
    broken = RunFolder(tmp_path / "broken")
    if fault != "no run":
        shutil.copytree(run, broken.path)
    match fault:
        case "unfinished":
            broken.map.unlink()
        case "no manifest":
            broken.manifest.write_text("[]")
        case "ledger":
            broken.ledger.write_text(broken.ledger.read_text().replace("step", "stop", 1))
        case "map":
            broken.map.write_bytes(b"no map")
    assert code_of(monkeypatch, "diff", run, broken.path) == 2
    assert str(broken.path) in capsys.readouterr().err


def test_runs_of_other_logs_or_other_frames_cannot_be_compared(
    room_log: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "other.mcap"
    source = RoomSource(seed=1, frames=ROOM_FRAMES)
    record(
        source, "another room", log, Selection(stop=3), overwrite=False, progress=lambda *_: None
    )
    replay(log, tmp_path / "another", replace(TINY, steps=1))
    with pytest.raises(ProgroundError, match="different logs: none of 3 frames"):
        compare_runs(run, tmp_path / "another")
    replay(room_log, tmp_path / "later", replace(TINY, steps=1, selection=Selection(start=8)))
    with pytest.raises(ProgroundError, match="no frame is in both"):
        compare_runs(run, tmp_path / "later")
    assert code_of(monkeypatch, "diff", run, tmp_path / "later") == 2


def test_a_log_of_which_a_frame_was_changed(run: Path, tmp_path: Path) -> None:
    """The logs are others, the frames the same but for one: it is named."""
    change = changed("frame", 5, lambda entry: entry.update(input="0" * 64))
    other = edited_run(run, tmp_path / "other", change)
    manifest = json.loads(RunFolder(other).manifest.read_text())
    RunFolder(other).manifest.write_text(json.dumps({**manifest, "log_sha256": "0"}))
    comparison = compare_runs(run, other)
    assert [origin.split(":")[0] for origin in comparison.origins] == ["log_sha256"]
    assert comparison.divergence is not None
    assert (comparison.divergence.frame, comparison.divergence.cause) == (5, "input")
