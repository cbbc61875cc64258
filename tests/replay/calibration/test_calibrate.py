"""Calibration: lines through what was measured, and measuring for real, if little of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pglog.commands import main
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.mapping import bench
from proground_log.mapping.neural import bench as neural_bench
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.of_log import task_of_labels
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.perception.vocabulary import write_vocabulary
from proground_log.run.cost_model import UNITS, CostModel
from proground_log.streams import stream
from recorders import room
from replay.calibration import measure as calibrate
from replay.calibration import work as calibration_work
from replay.calibration.measure import (
    Points,
    cost_model,
    fit_line,
    how_measured,
    measure,
    stage_cost,
)
from replay.calibration.work import stage_works
from tests.writers.small_source import SmallSource

pytestmark = pytest.mark.slow

SIZES = (10_000, 20_000, 40_000, 80_000, 160_000)


def points_of(fixed_ns: float, per_unit_ns: float, off: tuple[float, ...] = (0,) * 5) -> Points:
    """Points on a line, each off by a share of its time."""
    times_ns = ((fixed_ns + per_unit_ns * n) * (1 + o) for n, o in zip(SIZES, off, strict=True))
    return Points(SIZES, tuple(times_ns))


ZIGZAG = points_of(4e6, 1000, (0.6, -0.5, 0.6, -0.5, 0.4))


# The line.


@given(st.floats(1e3, 1e9), st.floats(1, 1e5))
def test_points_on_a_line_give_the_line(fixed_ns: float, per_unit_ns: float) -> None:
    points = points_of(fixed_ns, per_unit_ns)
    line = fit_line(points)
    for units, time_ns in zip(points.units, points.times_ns, strict=True):
        assert line.fixed_ns + line.per_unit_ns * units == pytest.approx(time_ns, rel=1e-6)
    assert np.abs(line.residuals).max() < 1e-6
    assert line.r_squared > 0.99 or fixed_ns > 1e3 * per_unit_ns


@pytest.mark.parametrize("seed", range(5))
def test_noise_moves_the_line_little(seed: int) -> None:
    noise = stream(seed, "noise").normal(0, 0.03, 5)
    line = fit_line(points_of(4e6, 1000, tuple(noise)))
    assert line.fixed_ns == pytest.approx(4e6, rel=0.3)
    assert line.per_unit_ns == pytest.approx(1000, rel=0.1)
    assert np.abs(line.residuals).max() < 0.1


@given(st.lists(st.floats(1e3, 1e9), min_size=5, max_size=5))
def test_no_part_of_a_cost_is_negative(times_ns: list[float]) -> None:
    line = fit_line(Points(SIZES, tuple(times_ns)))
    assert min(line.fixed_ns, line.per_unit_ns) >= 0


def test_the_line_is_the_best_by_relative_error() -> None:
    points = points_of(2e6, 500, (0.1, -0.08, 0.05, 0.02, -0.06))
    line = fit_line(points)
    units, times_ns = np.array(points.units), np.array(points.times_ns)

    def error(fixed_ns: float, per_unit_ns: float) -> float:
        return float((((fixed_ns + per_unit_ns * units) / times_ns - 1) ** 2).sum())

    best = error(line.fixed_ns, line.per_unit_ns)
    for a in (0.97, 1.0, 1.03):
        for b in (0.97, 1.0, 1.03):
            assert error(a * line.fixed_ns, b * line.per_unit_ns) >= best


def test_where_less_than_nothing_would_be_fixed_nothing_is() -> None:
    line = fit_line(Points((1, 2, 3), (0.5e6, 2e6, 3.5e6)))
    assert line.fixed_ns == 0
    assert line.per_unit_ns > 0


# What is no line.


def test_a_good_fit_becomes_a_cost() -> None:
    cost = stage_cost("step", points_of(4e6, 1000, (0.02, -0.02, 0.02, -0.02, 0.02)))
    assert cost.unit == "sample"
    assert cost.fixed_ns == pytest.approx(4e6, rel=0.1)
    assert 0 < cost.residual_percent < 5


def test_a_poor_fit_is_refused_with_its_figures() -> None:
    with pytest.raises(ProgroundError, match=r"times of step .* off by \d\d %, R² .*close other"):
        stage_cost("step", ZIGZAG)


def test_one_wild_size_is_refused_though_the_median_is_low() -> None:
    points = points_of(4e6, 1000, (0, 0, 0, 3, 0))
    assert np.median(np.abs(fit_line(points).residuals)) < 1
    with pytest.raises(ProgroundError, match="insert"):
        stage_cost("insert", points)


def test_a_stage_that_depends_on_no_size_is_no_poor_fit() -> None:
    cost = stage_cost("decode", points_of(1e7, 0, (0.02, -0.02, 0.01, 0.0, 0.02)))
    assert cost.fixed_ns == pytest.approx(1e7, rel=0.05)


def test_one_poor_stage_refuses_the_model() -> None:
    good = points_of(4e6, 1000)
    with pytest.raises(ProgroundError, match="semantic_step"):
        cost_model("desk", {"step": good, "semantic_step": ZIGZAG}, "now")


def test_a_model_says_what_it_was_measured_on(tmp_path: Path) -> None:
    model = cost_model("desk", {"step": points_of(4e6, 1000)}, how_measured(7, "a detector"))
    assert all(model.hardware[key] for key in ("processor", "cores", "threads"))
    assert all(part in model.measured for part in ("a detector", "7 calls", "torch", "numba"))
    model.write(tmp_path / "desk.json")
    assert CostModel.load(str(tmp_path / "desk.json")) == model


# Measuring.


@pytest.fixture
def small_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes that take seconds, each stage's largest much larger than its smallest."""
    monkeypatch.setattr(calibration_work, "WIDTHS", (64, 240))
    monkeypatch.setattr(neural_bench, "RAYS", (16, 512))
    monkeypatch.setattr(neural_bench, "SEMANTIC_RAYS", (12, 768))
    monkeypatch.setattr(neural_bench, "STEPS_BEFORE", 1)
    monkeypatch.setattr(bench, "FRAMES_BEFORE", 3)


@pytest.mark.usefixtures("small_work")
def test_measuring_for_real(room_log: Path) -> None:
    reader = LogReader(room_log)
    task = task_of_labels(reader, BuiltinTexts().knows)
    perceiver = SimulatedPerception(task, reader.label_names, reader.calibration.color, 0)
    told: list[tuple[int, int]] = []
    points = measure(
        reader, perceiver=perceiver, repeats=3, progress=lambda *done: told.append(done)
    )
    assert list(points) == list(UNITS)
    assert points["decode"].units == (2 * 64 * 48, 2 * 240 * 180)
    assert points["perceive"].units == (1, 2, 3)
    assert points["insert"].units == (64 * 48, 240 * 180)
    assert points["semantic_insert"].units == points["insert"].units
    assert points["step"].units == (16 * 43, 512 * 43)
    assert points["semantic_step"].units == (12 * 11, 768 * 11)
    for stage, some in points.items():
        assert min(some.times_ns) > 0, stage
    assert told == [(done, 24) for done in range(25)]


def test_what_is_measured_is_the_same_every_time(room_log: Path, tmp_path: Path) -> None:
    logs = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        stage_works(LogReader(room_log), None, folder)["decode"]()
        logs.append({path.name: path.read_bytes() for path in folder.iterdir()})
    assert logs[0] == logs[1]
    assert len(logs[0]) == len(calibration_work.WIDTHS)


def test_images_of_all_sizes_are_as_hard_to_decode_as_a_camera_s(
    room_log: Path, tmp_path: Path
) -> None:
    works = stage_works(LogReader(room_log), None, tmp_path)
    assert "perceive" not in works
    works["decode"]()
    for path in tmp_path.iterdir():
        frame = next(LogReader(path).frames())
        assert 0.3 < len(frame.color) / frame.depth.size < 1.5, path
        assert frame.labels is None


# The command.


def pglog(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["pglog", "calibrate", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert isinstance(stop.value.code, int)
    return stop.value.code


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> dict[str, Points]:
    """What measuring gives in place of this machine's own times, which no test can rely on."""
    points = {stage: points_of(4e6, 1000) for stage in UNITS if stage != "perceive"}
    monkeypatch.setattr(calibrate, "measure", lambda *_, **__: points)
    return points


def test_the_command_writes_what_it_prints(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    measured: dict[str, Points],
) -> None:
    # Times are given already; a log that is quick to make does.
    monkeypatch.setattr(room, "RoomSource", lambda frames: SmallSource(frames))
    path = tmp_path / "desk.json"
    assert pglog(monkeypatch, "-o", path) == 0
    printed = capsys.readouterr().out
    model = CostModel.load(str(path))
    assert model.name == "desk"
    assert list(model.stages) == list(measured)
    rows = [line.split("│")[1:-1] for line in printed.splitlines() if "sample" in line]
    cells = [[cell.strip() for cell in row] for row in rows]
    assert cells[0] == ["step", "sample", "4.00", "1,000.0", "0.0", "5"]
    assert pglog(monkeypatch, "-o", path, "--overwrite", "--name", "mine", "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert list(content.pop("points")["step"]["units"]) == list(SIZES)
    assert content == json.loads(path.read_text())
    assert content["name"] == "mine"


@pytest.mark.usefixtures("measured")
@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["-o", "taken.json"], "exists"),
        (["-o", "new.json", "--threads", "0"], "0 threads"),
        (["-o", "new.json", "--detector", "d.onnx"], "--detector and --vocabulary"),
        (["-o", "new.json", "--vocabulary", "v.npz"], "--detector and --vocabulary"),
        (["-o", "new.json", "--segmenter", "s.onnx"], "--detector and --vocabulary"),
        (["-o", "new.json", "--detector", "d.onnx", "--vocabulary", "gone.npz"], "gone.npz"),
        (["-o", "new.json", "--detector", "d.onnx", "--vocabulary", "v.npz"], "none of the room"),
        (["-o", "new.json", "--detector", "d.onnx", "--vocabulary", "w.npz"], "d.onnx"),
    ],
)
def test_the_command_refuses_before_it_measures(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: list[str],
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken.json").touch()
    write_vocabulary(Path("v.npz"), ["submarine"], BuiltinTexts().embed(["sofa"]))
    write_vocabulary(Path("w.npz"), ["sofa"], BuiltinTexts().embed(["sofa"]))
    assert pglog(monkeypatch, *arguments) == 2
    answer = capsys.readouterr()
    assert complaint in answer.err
    assert answer.err.count("\n") == 1
    assert answer.out == ""
    assert not Path("new.json").exists()
