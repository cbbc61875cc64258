"""The report of real runs: it says what their files say, and what they lack."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import tyro

from proground_log.errors import ProgroundError
from proground_log.evaluation import judge
from proground_log.evaluation.judge import Evaluation
from proground_log.field.config import FieldConfig
from proground_log.frame import Selection
from proground_log.log.reader import LogReader
from proground_log.mapping.neural.config import (
    BufferConfig,
    NeuralConfig,
    SamplingConfig,
    SemanticsConfig,
)
from proground_log.perception.perceive import perceive
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.perception.task import Task
from proground_log.query import surface
from proground_log.query.voxels import OBJECTS_VOXEL_M
from proground_log.report import run_page, things, views
from proground_log.report.page import Charts, Note, Page, Table, Views
from proground_log.report.run_page import page_of, write_report
from proground_log.run import opened
from proground_log.run.history import read_history
from proground_log.run.ledger import bits_float, read_ledger
from proground_log.run.settings import ReplayConfig, SimulationConfig, TelemetryConfig, flags
from replay.session import replay

pytestmark = pytest.mark.slow

WICKED = "<script>alert(1)</script>"
SMALL = NeuralConfig(
    field=FieldConfig(log2_rows=12, levels=4, voxel_m=0.1),
    sampling=SamplingConfig(rays=64, uniform=8, near_surface=5),
    semantics=SemanticsConfig(rays=32, background_rays=16, samples=3),
    buffer=BufferConfig(capacity=20_000, keyframe_samples=1000),
)
QUIET = TelemetryConfig(enabled=False)
PLAIN = ReplayConfig(
    steps=2, max_frames=3, mapper=SMALL, telemetry=QUIET, simulation=SimulationConfig()
)
HURRIED = replace(PLAIN, max_frames=10, simulation=SimulationConfig(budget_ms=250.0))


def silent(_done: int, _total: int) -> None:
    pass


@pytest.fixture(scope="module", autouse=True)
def small_pictures() -> Iterator[None]:
    """What the pictures show is not what is tested here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(views, "VIEW_WIDTH", 24)
        patch.setattr(views, "FRAMES_SHOWN", 2)
        patch.setattr(things, "OBJECTS_VOXEL_M", 0.12)
        yield


@pytest.fixture(scope="module")
def plain_run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without regions and budget."""
    path = tmp_path_factory.mktemp("plain") / "run"
    replay(room_log, path, PLAIN)
    return path


@pytest.fixture(scope="module")
def rich_run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With regions, a budget that is too small, and a task of a wicked name."""
    folder = tmp_path_factory.mktemp("rich")
    reader = LogReader(room_log)
    task = Task(WICKED, ("sofa", "bed", "table"))
    perceiver = SimulatedPerception(
        task, reader.label_names, reader.calibration.color, seed=0, strength=0.0
    )
    perceive(room_log, perceiver, folder / "seen.mcap", overwrite=False, progress=silent)
    replay(folder / "seen.mcap", folder / "run", HURRIED)
    return folder / "run"


@pytest.fixture(autouse=True)
def quick_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judging has tests of its own and takes most of the time."""
    scores = {"psnr_db": 21.27, "ssim": 0.8764, "judged_points": 7.0}
    verdict = Evaluation(scores=scores, classes={"bed": (1200, 62.5)})
    monkeypatch.setattr(run_page, "evaluate_run", lambda *_, **__: verdict)


@pytest.fixture(scope="module")
def page(rich_run: Path) -> Page:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_page, "evaluate_run", lambda *_, **__: Evaluation())
        return page_of(rich_run, None, silent)


def section(page: Page, title: str) -> list[object]:
    return next(list(part.contents) for part in page.sections if part.title == title)


def notes(page: Page, title: str) -> str:
    return " ".join(part.text for part in section(page, title) if isinstance(part, Note))


def test_the_history_is_the_ledgers(rich_run: Path) -> None:
    history = read_history(rich_run / "ledger.jsonl")
    entries = list(read_ledger(rich_run / "ledger.jsonl"))
    rgb = [bits_float(e["losses"]["rgb"]) for e in entries if e["event"] == "step"]
    assert history.losses["rgb"].tolist() == rgb
    result = json.loads((rich_run / "manifest.json").read_text())["result"]
    assert len(history.done_s) == result["frames mapped"]
    assert len(history.dropped_s) == result["frames dropped"] > 0
    assert history.steps.sum() == result["steps"]
    for stage, spent_ms in history.spent_ms.items():
        seconds = result["simulation"][f"{stage} s"]
        assert spent_ms.sum() / 1000 == pytest.approx(seconds, abs=1e-3)
    assert history.lag_s.max() == pytest.approx(result["simulation"]["worst lag s"], abs=1e-4)
    samples = history.counts["buffer"]["samples"]
    assert history.held["buffer"]["samples"] == samples[-1] == result["buffer samples"]


def test_everything_is_read_and_made_once(rich_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_page, "evaluate_run", judge.evaluate_run)
    monkeypatch.setattr(things, "OBJECTS_VOXEL_M", OBJECTS_VOXEL_M)
    calls: Counter[str] = Counter()

    def counted(module: ModuleType, name: str) -> None:
        inner = getattr(module, name)

        def outer(*arguments: Any, **named: Any) -> Any:
            # A mesh of other voxels is another mesh.
            calls[f"{name} {arguments[-1]}" if name == "extract_mesh" else name] += 1
            return inner(*arguments, **named)

        monkeypatch.setattr(module, name, outer)

    for name in ("file_sha256", "load_map", "read_history", "LogReader"):
        counted(opened, name)
    for name in ("extract_mesh", "find_sightings", "objects_of_regions"):
        counted(surface, name)
    page_of(rich_run, None, silent)
    meshes = {name for name in calls if name.startswith("extract_mesh")}
    assert len(meshes) == 2
    others = {"file_sha256", "load_map", "read_history", "LogReader"}
    assert set(calls) == meshes | others | {"find_sightings", "objects_of_regions"}
    assert set(calls.values()) == {1}


def test_a_rich_run_shows_everything(page: Page) -> None:
    charts = [part for part in section(page, "Simulated time") if isinstance(part, Charts)]
    assert len(charts) == 1
    assert "250 ms a frame" in notes(page, "Simulated time")
    views = [part for part in section(page, "Views") if isinstance(part, Views)]
    assert [len(pictures) for _, pictures in views[0].frames] == [6] * 2
    assert "Semantics, labels:" in notes(page, "Memory")


def test_a_plain_run_says_what_it_lacks(plain_run: Path) -> None:
    page = page_of(plain_run, None, silent)
    assert "No budget: every mapped frame got 2 steps" in notes(page, "Simulated time")
    assert "No labels" in notes(page, "Views")
    assert "no meaning was learnt" in notes(page, "Objects")
    assert "No memory of meaning" in notes(page, "Memory")
    assert all(part.contents for part in page.sections)
    tables = [part for part in section(page, "Simulated time") if isinstance(part, Table)]
    assert "step" in [row[0] for row in tables[0].rows]


def test_what_cannot_be_judged_says_why(plain_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> Evaluation:
        raise ProgroundError("there is nothing to judge it by", where="run", todo="hold out some")

    monkeypatch.setattr(run_page, "evaluate_run", refuse)
    page = page_of(plain_run, None, silent)
    assert "there is nothing to judge it by; hold out some" in notes(page, "Quality")
    assert "Colour (PSNR)" not in [tile.name for tile in page.tiles]


def test_the_same_run_gives_the_same_bytes_and_its_names_are_text(
    rich_run: Path, tmp_path: Path
) -> None:
    pages = []
    for name in ("first.html", "second.html"):
        write_report(rich_run, tmp_path / name, None, silent, overwrite=False)
        pages.append((tmp_path / name).read_text())
    assert pages[0] == pages[1]
    assert WICKED not in pages[0]
    assert "<h1>&lt;script&gt;alert(1)&lt;/script&gt; in seen.mcap</h1>" in pages[0]
    assert "21.3" in pages[0]
    assert "Structure (SSIM)</span><b>0.88 <small>of 1</small>" in pages[0]
    assert "62.5 % of 1,200" in pages[0]
    with pytest.raises(ProgroundError, match="the output exists"):
        write_report(rich_run, tmp_path / "first.html", None, silent, overwrite=False)


def test_a_log_that_moved_is_found_and_another_is_refused(
    rich_run: Path, room_log: Path, tmp_path: Path
) -> None:
    moved = tmp_path / "moved.mcap"
    shutil.copy(rich_run.with_name("seen.mcap"), moved)
    assert page_of(rich_run, moved, silent).title == f"{WICKED} in moved.mcap"
    with pytest.raises(ProgroundError, match="is not the log that the run was made of"):
        page_of(rich_run, room_log, silent)


@pytest.mark.parametrize(
    "config",
    [
        ReplayConfig(),
        HURRIED,
        replace(
            PLAIN,
            selection=Selection(start=3, stop=9, stride=2),
            keep_checkpoints=True,
            simulation=SimulationConfig(rate=0.5, overrun="wait", perceive_beside=True),
            mapper=replace(SMALL, semantics=SemanticsConfig(enabled=False), beta=0.5),
        ),
    ],
)
def test_the_command_gives_the_same_settings_again(config: ReplayConfig) -> None:
    words = [word for flag in flags(config) for word in flag]
    again = tyro.cli(
        ReplayConfig,
        args=words,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    assert again == config
    assert (flags(config) == []) == (config == ReplayConfig())
