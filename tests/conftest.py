"""What tests of several folders share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import transform
from proground_log.frame import Selection, SensorFrame
from recorders.record import record
from recorders.room import RoomSource
from recorders.source import Source
from tests.commands import Answer, Pglog

SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


def pytest_configure() -> None:
    """Forget the width of the terminal before anything is imported that would keep it."""
    os.environ.pop("COLUMNS", None)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the repository."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no real data in {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture
def pglog(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Pglog:
    """Runs a command in this process, in a terminal of 100 columns."""
    from pglog.commands import main

    monkeypatch.setenv("COLUMNS", "100")

    def run(*arguments: object) -> Answer:
        monkeypatch.setattr(sys, "argv", ["pglog", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main()
        printed = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return Answer(stop.value.code, printed.out, printed.err)

    return run


@pytest.fixture(scope="session")
def room_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the built-in room with 12 frames; read it, do not change it."""
    path = tmp_path_factory.mktemp("room") / "room.mcap"
    room = RoomSource(frames=12)
    record(room, "room", path, Selection(), overwrite=False, progress=lambda *_: None)
    return path


@pytest.fixture(scope="session")
def room() -> RoomSource:
    """The built-in room along a way of 120 frames, so that neighbouring frames overlap."""
    return RoomSource()


@pytest.fixture(scope="session")
def room_frames(room: RoomSource) -> list[SensorFrame]:
    """Six neighbouring frames of the room: what fixtures of other formats are written from."""
    return [room.frame(index) for index in range(6)]


@pytest.fixture(scope="session")
def depth_agreement() -> Callable[[Source, SensorFrame, SensorFrame, float], float]:
    """Share of the first frame's depth that the second one confirms within a tolerance (m)."""

    def agreement(
        source: Source, first: SensorFrame, second: SensorFrame, tolerance_m: float
    ) -> float:
        camera = source.calibration.depth
        points = camera.unproject(first.depth_m)[first.depth_m > 0]
        second_from_first = np.linalg.inv(second.world_from_camera) @ first.world_from_camera
        points = transform(second_from_first, points.astype(np.float64))
        points = points[points[:, 2] > 0.1]
        columns, rows = np.floor(camera.project(points)).astype(int).T
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        measured_m = second.depth_m[rows[inside], columns[inside]]
        error_m = np.abs(measured_m - points[inside, 2])[measured_m > 0]
        return float(np.mean(error_m < tolerance_m))

    return agreement
