"""Opening runs and logs; the pictures need a Vulkan driver."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun.blueprint as rrb

from proground_log.bounds import Bounds
from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.events import Event, TaskKnown
from proground_log.frame import SensorFrame
from proground_log.log.recording import Origin, Recording
from proground_log.log.writer import open_writer
from proground_log.telemetry import rerun_sink, viewer
from proground_log.telemetry.blueprint import replay_blueprint
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from proground_log.telemetry.viewer import screenshot, view
from tests.telemetry import telemetry_stream as stream

VULKAN_DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("*.json")]


def test_what_is_neither_log_nor_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match=r"has no telemetry\.rrd"):
        view([tmp_path])
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ProgroundError, match="neither a log nor a run"):
        view([tmp_path / "notes.txt"])
    with pytest.raises(ProgroundError, match="no such file"):
        view([tmp_path / "absent.mcap"])
    (tmp_path / "broken.mcap").write_text("not a log")
    with pytest.raises(ProgroundError, match="no MCAP file"):
        view([tmp_path / "broken.mcap"])


def test_a_viewer_that_ends_when_it_is_to_draw_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a driver it answers first, and is gone when a file is to be opened."""

    class Gone:
        def open(self, _: list[str]) -> None:
            raise ConnectionError("transport error")

    write_run(tmp_path)
    monkeypatch.setattr(viewer, "_command", lambda *_: [sys.executable, "-c", ""])
    monkeypatch.setattr(viewer, "_connect", lambda *_: Gone())
    with pytest.raises(ProgroundError, match=r"did not start; install a Vulkan driver"):
        screenshot([tmp_path], tmp_path / "a.png")


needs_vulkan = pytest.mark.skipif(
    not VULKAN_DRIVERS, reason="no Vulkan driver (mesa-vulkan-drivers)"
)


def assert_drawn(
    picture: Path, views: dict[str, tuple[float, float, float, float]], *, share: float = 0.1
) -> None:
    """Fail unless each view (left, right, top, bottom, of 1) is colourful in that share of it.

    The viewer's own frames, texts and grids are grey: an empty view measures below 0.008, while
    its contrast alone would pass for a picture.
    """
    image = cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2HSV)
    height, width = image.shape[:2]
    for name, (left, right, top, bottom) in views.items():
        rows = slice(int(top * height), int(bottom * height))
        cell = image[rows, int(left * width) : int(right * width)]
        colourful = ((cell[..., 1] > 90) & (cell[..., 2] > 60)).mean()
        assert colourful > share, f"the view of the {name} is empty ({colourful:.4f})"


def write_run(
    folder: Path, task: TaskKnown | None = None, events: Iterable[Event] | None = None
) -> None:
    """A run's recording, of three frames where no events are given."""
    sink = TelemetrySink(folder / "telemetry.rrd", recording_id="run")
    for event in events or stream.of_frames(range(3), task):
        sink.on_event(event)
    sink.on_event(stream.FINISHED)
    sink.close()
    merge_segments([folder / "telemetry.rrd"], folder / "telemetry.rrd")


@pytest.mark.slow
@needs_vulkan
def test_a_run_shows_what_matters_without_a_click(tmp_path: Path) -> None:
    write_run(tmp_path)
    picture = tmp_path / "viewer.png"
    assert screenshot([tmp_path], picture, (1000, 625)) == []
    assert_drawn(
        picture,
        {
            "map": (0.02, 0.45, 0.10, 0.68),
            "input colour": (0.46, 0.63, 0.14, 0.34),
            "rendered colour": (0.64, 0.81, 0.14, 0.34),
            "colour error": (0.83, 0.99, 0.14, 0.34),
            "input depth": (0.46, 0.63, 0.50, 0.66),
            "rendered depth": (0.64, 0.81, 0.50, 0.66),
            "depth error": (0.83, 0.99, 0.50, 0.66),
        },
    )
    assert_drawn(picture, {"losses": (0.02, 0.36, 0.75, 0.94)}, share=0.01)


@pytest.mark.slow
@needs_vulkan
def test_a_run_with_a_task_shows_labels_and_scores_without_a_click(tmp_path: Path) -> None:
    write_run(tmp_path, stream.TASK)
    picture = tmp_path / "viewer.png"
    assert screenshot([tmp_path], picture, (1280, 800)) == []
    columns = {"input": (0.48, 0.61), "rendered": (0.66, 0.79), "error": (0.84, 0.97)}
    rows = {"colour": (0.13, 0.28), "depth": (0.36, 0.49), "labels": (0.56, 0.69)}
    cells = {
        f"{column} {row}": (left, right, top, bottom)
        for column, (left, right) in columns.items()
        for row, (top, bottom) in rows.items()
    }
    assert_drawn(picture, {"map": (0.02, 0.45, 0.12, 0.68)} | cells)
    plots = {
        "losses": (0.02, 0.18, 0.76, 0.94),
        "heads": (0.25, 0.39, 0.76, 0.94),
        "labels": (0.56, 0.76, 0.76, 0.94),
    }
    assert_drawn(picture, plots, share=0.003)


def click_second_tabs(part: rrb.Container | rrb.View) -> None:
    """Show the second tab wherever a layout has tabs, the outermost left alone."""
    for inner in getattr(part, "contents", ()):
        if isinstance(inner, rrb.Tabs):
            inner.active_tab = 1
        click_second_tabs(inner)


@pytest.mark.slow
@needs_vulkan
def test_the_tabs_of_meaning_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    layout = replay_blueprint(stream.mapper_known(stream.TASK))
    click_second_tabs(layout.root_container)
    monkeypatch.setattr(rerun_sink, "replay_blueprint", lambda _: layout)
    write_run(tmp_path, stream.TASK)
    picture = tmp_path / "viewer.png"
    assert screenshot([tmp_path], picture, (1280, 800)) == []
    columns = (0.48, 0.61), (0.66, 0.79), (0.84, 0.97)
    titles = (
        ("input colour", "input labels", "rendered labels"),
        ("embeddings", "scale", "uncertainty"),
    )
    cells = {
        title: (*column, *rows)
        for row, rows in zip(titles, ((0.17, 0.35), (0.48, 0.66)), strict=True)
        for title, column in zip(row, columns, strict=True)
    }
    assert_drawn(picture, cells | {"map's labels": (0.02, 0.45, 0.12, 0.68)})
    assert_drawn(picture, {"semantic loss": (0.02, 0.18, 0.76, 0.94)}, share=0.003)


@pytest.mark.slow
@needs_vulkan
def test_the_budget_tab_draws_the_schedule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    layout = replay_blueprint(stream.mapper_known(None))
    assert isinstance(layout.root_container, rrb.Tabs)
    layout.root_container.active_tab = 1
    monkeypatch.setattr(rerun_sink, "replay_blueprint", lambda _: layout)
    hurried = replace(stream.UNHURRIED, budget_ns=180_000_000, overrun="drop-oldest")
    write_run(tmp_path, events=stream.of_frames(range(12), None, hurried))
    picture = tmp_path / "viewer.png"
    assert screenshot([tmp_path], picture, (1280, 800)) == []
    plots = {
        "lanes": (0.10, 0.98, 0.10, 0.43),
        "lag": (0.12, 0.48, 0.48, 0.68),
        "spent": (0.62, 0.98, 0.48, 0.68),
        "steps": (0.34, 0.49, 0.74, 0.94),
        "drops": (0.60, 0.74, 0.74, 0.94),
        "reasons": (0.80, 0.85, 0.78, 0.95),
    }
    assert_drawn(picture, plots, share=0.003)


@pytest.mark.slow
@needs_vulkan
def test_a_log_shows_depth_in_space_and_its_images(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    log = tmp_path / "tiny.mcap"
    origin, names = Origin("tiny", "test", {}), {1: "near", 2: "far"}
    with open_writer(log, Calibration.registered(stream.CAMERA), origin, names, None) as writer:
        for index in range(2):
            pose = np.eye(4)
            pose[:3, 3] = stream.position_m(index)
            _, color = cv2.imencode(".png", rng.integers(0, 256, (48, 64, 3), dtype=np.uint8))
            depth = rng.integers(1000, 3000, (48, 64), dtype=np.uint16)
            labels = (depth // 1000).astype(np.uint16)
            time_ns = index * stream.FRAME_NS
            frame = SensorFrame(
                index, time_ns, time_ns, color.tobytes(), "png", depth, pose, labels
            )
            writer.write(frame)
        bounds = Bounds((-4.0, -4.0, -4.0), (4.0, 4.0, 4.0))
        writer.finish(Recording("tiny", "test", 2, bounds, {}))
    picture = tmp_path / "viewer.png"
    assert screenshot([log], picture, (800, 500)) == []
    assert_drawn(
        picture,
        {
            "scene": (0.00, 0.60, 0.15, 0.90),
            "colour": (0.65, 1.00, 0.17, 0.32),
            "depth": (0.65, 1.00, 0.45, 0.62),
            "labels": (0.65, 1.00, 0.75, 0.92),
        },
    )
