"""Whatever stops a recorder, no more than the last second of the recording is lost."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from proground_log.frame import Selection, SensorFrame
from proground_log.log import topics
from proground_log.log.checking.check import check_log
from proground_log.log.reader import LogReader
from recorders.record import record
from recorders.recover import recover
from tests.full_disk import largest_file
from tests.writers.small_source import SmallSource

pytestmark = pytest.mark.slow

FRAMES = 300
SECOND_NS = 1_000_000_000

RECORDER = """
import sys, time
from pathlib import Path
from proground_log.frame import Selection
from recorders.record import record
from tests.writers.small_source import SmallSource

class Slow(SmallSource):
    def frame(self, index):
        time.sleep(0.002)
        return super().frame(index)

def told(done, total):
    print(done, flush=True)

source = Slow(int(sys.argv[2]), with_labels=True)
record(source, "small data", Path(sys.argv[1]), Selection(), overwrite=False, progress=told)
"""


def raw_frames(path: Path) -> list[tuple[int, dict[str, bytes]]]:
    """Of each frame the time and the bytes of its messages."""
    return [
        (group[0][2].log_time, {channel.topic: message.data for _, channel, message in group})
        for group in LogReader(path).groups()
    ]


def quiet(_done: int, _total: int) -> None: ...


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[int, dict[str, bytes]]]:
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    source = SmallSource(FRAMES, with_labels=True)
    record(source, "small data", path, Selection(), overwrite=False, progress=quiet)
    return raw_frames(path)


def written_for_sure(frames: int) -> int:
    """How many frames a file holds after so many: it is flushed as a second begins."""
    stamps_ns = [SmallSource().frame(index).stamp_ns for index in range(frames)]
    seconds = [stamp_ns // SECOND_NS for stamp_ns in stamps_ns]
    return 1 + max(index for index in range(frames) if seconds[index] not in seconds[:index])


def killed_recorder(log: Path, seed: int) -> int:
    """Kill a recorder anywhere; returns how many frames it had said were written."""
    rng = np.random.default_rng(seed)
    frame, more_s = int(rng.integers(1, FRAMES - 50)), rng.uniform(0, 0.02)
    command = [sys.executable, "-c", RECORDER, str(log), str(FRAMES)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline() != f"{frame}\n":
            assert process.poll() is None
        time.sleep(more_s)
        process.kill()
        lines = process.stdout.read().splitlines(keepends=True)
    return max((int(line) for line in lines if line.endswith("\n")), default=frame)


def assert_survives(folder: Path, whole: list[tuple[int, dict[str, bytes]]], seed: int) -> None:
    folder.mkdir()
    log = folder / "a.mcap"
    told = killed_recorder(log, seed)
    assert not log.exists()
    partial = folder / "a.mcap.partial"
    before = partial.read_bytes()
    recovery = recover(partial, log, overwrite=False, progress=quiet)
    assert partial.read_bytes() == before
    assert recovery.damage == ("the end of the file",)
    saved = raw_frames(log)
    assert len(saved) == recovery.frames >= written_for_sure(told)
    assert saved == whole[: len(saved)]
    assert whole[told - 1][0] - saved[-1][0] <= SECOND_NS
    assert check_log(log, quiet) == []


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_recorder(
    seed: int, tmp_path: Path, whole: list[tuple[int, dict[str, bytes]]]
) -> None:
    assert_survives(tmp_path / "a", whole, seed)


@pytest.mark.long
def test_fifty_killed_recorders(tmp_path: Path, whole: list[tuple[int, dict[str, bytes]]]) -> None:
    for seed in range(4, 54):
        assert_survives(tmp_path / str(seed), whole, seed)


def test_the_log_of_a_killed_recorder_is_named_as_such(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    killed_recorder(log, 0)
    partial = tmp_path / "a.mcap.partial"
    message = r"a\.mcap\.partial: the recording was stopped before its end; .*`pglog recover`"
    with pytest.raises(ProgroundError, match=message):
        check_log(partial, quiet)


@dataclass
class Stopped(SmallSource):
    """A source that something happens to at frame 100."""

    happens: Callable[[], None] = lambda: None

    def frame(self, index: int) -> SensorFrame:
        if index == 100:
            self.happens()
        return super().frame(index)


def press_ctrl_c() -> None:
    raise KeyboardInterrupt


def assert_saved(log: Path, error: BaseException, whole: list[tuple[int, dict[str, bytes]]]) -> int:
    """The error says how to save how many frames, and that is so."""
    partial = log.with_name("a.mcap.partial")
    assert sorted(log.parent.iterdir()) == [partial]
    start, _, count = str(error).rpartition(": ")
    assert start.endswith(f"`pglog recover {partial} -o {log}` saves the frames so far")
    recovery = recover(partial, log, overwrite=False, progress=quiet)
    assert recovery.frames == int(count)
    assert raw_frames(log) == whole[: recovery.frames]
    return recovery.frames


def test_ctrl_c_keeps_the_frames(tmp_path: Path, whole: list[tuple[int, dict[str, bytes]]]) -> None:
    source = Stopped(FRAMES, with_labels=True, happens=press_ctrl_c)
    log = tmp_path / "a.mcap"
    with pytest.raises(KeyboardInterrupt) as stop:
        record(source, "small data", log, Selection(), overwrite=False, progress=quiet)
    assert assert_saved(log, stop.value, whole) == written_for_sure(100)


@pytest.mark.parametrize("size_bytes", [200_000, 500_000])
def test_a_full_disk_keeps_the_frames(
    size_bytes: int, tmp_path: Path, whole: list[tuple[int, dict[str, bytes]]]
) -> None:
    source, log = SmallSource(FRAMES, with_labels=True), tmp_path / "a.mcap"
    with largest_file(size_bytes), pytest.raises(ProgroundError) as full:
        record(source, "small data", log, Selection(), overwrite=False, progress=quiet)
    assert full.value.what.startswith("cannot write: ")
    assert full.value.where == str(log)
    assert assert_saved(log, full.value, whole) > 10


def test_what_has_no_frame_is_not_kept(tmp_path: Path) -> None:
    source, log = SmallSource(FRAMES, with_labels=True), tmp_path / "a.mcap"
    with largest_file(1000), pytest.raises(ProgroundError, match=r"write elsewhere$"):
        record(source, "small data", log, Selection(), overwrite=False, progress=quiet)
    assert list(tmp_path.iterdir()) == []


def test_a_broken_source_leaves_what_was_recorded_before(tmp_path: Path) -> None:
    def breaks() -> None:
        raise ProgroundError("is broken", where="frame 100", todo="mend it")

    log, partial = tmp_path / "a.mcap", tmp_path / "a.mcap.partial"
    source = Stopped(FRAMES, happens=breaks)
    with pytest.raises(
        ProgroundError, match=r"^frame 100: is broken; mend it; `pglog recover"
    ) as e:
        record(source, "small", log, Selection(), overwrite=False, progress=quiet)
    assert list(tmp_path.iterdir()) == [partial]
    with pytest.raises(ProgroundError, match="is what a recording that was stopped left"):
        record(source, "small", log, Selection(), overwrite=False, progress=quiet)
    saved = recover(partial, log, overwrite=False, progress=quiet).frames
    assert saved > 0
    assert e.value.todo.endswith(f"saves the frames so far: {saved}")


def test_a_recording_over_a_log_that_is_stopped_leaves_the_log(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(b"before")
    source = Stopped(FRAMES, happens=press_ctrl_c)
    with pytest.raises(KeyboardInterrupt, match="pglog recover"):
        record(source, "small", log, Selection(), overwrite=True, progress=quiet)
    assert log.read_bytes() == b"before"
    recover(tmp_path / "a.mcap.partial", log, overwrite=True, progress=quiet)
    assert topics.RECORDING_METADATA in LogReader(log).metadata
