"""Sources and logs behind URLs: read in place, by the same commands, to the same result."""

from __future__ import annotations

import http.server
import re
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from pglog.commands import PGLOG
from pglog.parsing import parsed
from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.frame import Selection, SensorFrame
from proground_log.locations import INSTALL, located
from proground_log.log.reader import LogReader
from recorders.record import record
from recorders.registry import open_source
from recorders.room.source import CAMERA
from tests.writers.small_source import SmallSource, write_log


class RangeHandler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder; unlike its parent, it answers requests for a part of a file."""

    asked_bytes = 0

    def do_GET(self) -> None:
        """Answer with the part that is asked for."""
        file = Path(self.translate_path(self.path))
        if not file.is_file():
            super().do_GET()
            return
        data, wanted = file.read_bytes(), self.headers.get("Range")
        first, _, last = (wanted or "bytes=0-").removeprefix("bytes=").partition("-")
        part = data[int(first) : int(last) + 1 if last else None]
        type(self).asked_bytes += len(part)
        self.send_response(206 if wanted else 200)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(len(part)))
        if wanted:
            end = int(first) + len(part) - 1
            self.send_header("Content-Range", f"bytes {first}-{end}/{len(data)}")
        self.end_headers()
        self.wfile.write(part)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder, and the URL at which it is served."""
    folder = tmp_path / "served"
    folder.mkdir()

    def handler(*arguments: object) -> RangeHandler:
        return RangeHandler(*arguments, directory=str(folder))  # type: ignore[arg-type]

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield folder, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_path_stays_a_path() -> None:
    assert located("a/b.mcap") == Path("a/b.mcap")
    assert located("C:/a b") == Path("C:/a b")


def test_a_log_behind_a_url_reads_as_it_does_here(served: tuple[Path, str]) -> None:
    folder, url = served
    source = SmallSource(3, with_labels=True)
    write_log(folder / "a.mcap", source)
    reader = LogReader(located(f"{url}/a.mcap"))
    assert reader.label_names == source.label_names
    for frame, wanted in zip(reader.frames(), map(source.frame, range(3)), strict=True):
        assert bytes(frame.color) == wanted.color
        assert frame.depth.tobytes() == wanted.depth.tobytes()


def test_a_command_takes_a_url(
    served: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, url = served
    write_log(folder / "a.mcap")
    assert parsed(PGLOG, ["check", f"{url}/a.mcap"])() == 0
    assert "no fault found" in capsys.readouterr().out


def test_what_is_not_there_is_named(served: tuple[Path, str]) -> None:
    with pytest.raises(ProgroundError, match=r"/b\.mcap: no such file, or it cannot be reached"):
        LogReader(located(f"{served[1]}/b.mcap"))


@pytest.mark.parametrize("missing", ["upath", "s3fs"])
def test_what_a_url_needs_and_is_missing_is_named(
    missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(
        ProgroundError, match=rf"URLs need more .*{missing}.*; {re.escape(INSTALL)}"
    ):
        located("s3://bucket/a.mcap")


def test_an_unknown_kind_of_url_is_refused() -> None:
    with pytest.raises(ProgroundError, match="nowhere://x: no such kind of URL"):
        located("nowhere://x")


@pytest.mark.parametrize("kind", ["memory", "http"])
def test_a_data_set_behind_a_url_becomes_the_same_log(
    kind: str, served: tuple[Path, str], tmp_path: Path, room_frames: list[SensorFrame]
) -> None:
    folder, url = served
    here = folder / "seq-01"
    write_seven_scenes(here, room_frames[:2])
    there = located(f"{url}/seq-01")
    if kind == "memory":
        there = located("memory://test/seq-01")
        there.mkdir(parents=True)
        for file in here.iterdir():
            (there / file.name).write_bytes(file.read_bytes())
    logs = []
    for name, place in (("here", here), ("there", there)):
        logs.append(tmp_path / f"{name}.mcap")
        source = open_source("seven-scenes", place, calibration=Calibration.registered(CAMERA))
        record(source, "seq-01", logs[-1], Selection(), overwrite=False, progress=lambda *_: None)
    assert logs[0].read_bytes() == logs[1].read_bytes()


def write_seven_scenes(folder: Path, frames: list[SensorFrame]) -> None:
    folder.mkdir()
    for index, frame in enumerate(frames):
        stem = folder / f"frame-{index:06d}"
        Path(f"{stem}.color.jpg").write_bytes(frame.color)
        cv2.imwrite(f"{stem}.depth.png", frame.depth)
        np.savetxt(f"{stem}.pose.txt", frame.world_from_camera)


def test_a_log_can_be_written_to_a_url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    here, there = write_log(tmp_path / "a.mcap"), "memory://logs/b.mcap"
    assert parsed(PGLOG, ["recover", str(here), "-o", there])() == 0
    assert [frame.color for frame in LogReader(located(there)).frames()] == [
        frame.color for frame in LogReader(here).frames()
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    with pytest.raises(ProgroundError, match="the output exists"):
        parsed(PGLOG, ["recover", str(here), "-o", there])()


def test_a_store_that_does_not_answer_is_named() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{unused.getsockname()[1]}/a.mcap"
        with pytest.raises(ProgroundError, match=rf"{url}: (cannot be reached|no such file)"):
            LogReader(located(url))
