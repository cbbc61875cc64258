"""A replay that was interrupted, or killed, and resumed leaves one recording."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from proground_log.errors import ProgroundError
from proground_log.events import TaskKnown
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from tests.telemetry import telemetry_stream as stream
from tests.telemetry.telemetry_cells import cells_of

pytestmark = pytest.mark.slow

KILLED = """
import os, signal, sys
from pathlib import Path
from tests.telemetry import telemetry_stream as stream
from proground_log.telemetry.rerun_sink import TelemetrySink

sink = TelemetrySink(Path(sys.argv[1]), recording_id="run")
for event in stream.of_frames(range(3)):
    sink.on_event(event)
sink.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def record(
    path: Path, frames: range, *, finish: bool = False, task: TaskKnown | None = None
) -> Path:
    first = frames.start
    sink = TelemetrySink(
        path,
        recording_id="run",
        steps_done=first * stream.STEPS_PER_FRAME,
        last_position_m=stream.position_m(first - 1) if first else None,
    )
    for event in stream.of_frames(frames, task):
        sink.on_event(event)
    if finish:
        sink.on_event(stream.FINISHED)
    sink.close()
    return path


def whole(
    path: Path, frames: range, *, finish: bool = False, task: TaskKnown | None = None
) -> Path:
    """One segment, made a recording."""
    merge_segments([record(path, frames, finish=finish, task=task)], path)
    return path


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    path = tmp_path / "killed.rrd"
    here = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], cwd=here, check=False)
    assert done.returncode == -9
    with pytest.raises(RuntimeError):
        RrdReader(path)  # It has no footer.
    return path


@pytest.mark.parametrize("task", [None, stream.TASK], ids=["geometry", "meaning"])
def test_segments_make_the_recording_that_one_go_makes(
    tmp_path: Path, task: TaskKnown | None
) -> None:
    in_one_go = whole(tmp_path / "whole.rrd", range(6), finish=True, task=task)
    segments = [
        record(tmp_path / "0.rrd", range(2), task=task),
        record(tmp_path / "1.rrd", range(2, 4), task=task),
        record(tmp_path / "2.rrd", range(4, 6), finish=True, task=task),
    ]
    merge_segments(segments, tmp_path / "merged.rrd")
    assert cells_of(tmp_path / "merged.rrd") == cells_of(in_one_go)


def test_a_killed_segment_merges(tmp_path: Path, killed: Path) -> None:
    rest = record(tmp_path / "rest.rrd", range(3, 6), finish=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        merge_segments([killed, rest], killed)
        merged = cells_of(killed)
        assert RrdReader(killed).blueprints()
    assert merged == cells_of(whole(tmp_path / "whole.rrd", range(6), finish=True))


def test_a_segment_torn_in_a_message_keeps_what_precedes_it(tmp_path: Path, killed: Path) -> None:
    torn = tmp_path / "torn.rrd"
    torn.write_bytes(killed.read_bytes()[:-700])
    rest = whole(tmp_path / "rest.rrd", range(3, 6))
    merge_segments([torn, rest], tmp_path / "merged.rrd")
    in_one_go = cells_of(whole(tmp_path / "whole.rrd", range(6)))
    merged = cells_of(tmp_path / "merged.rrd")
    assert merged <= in_one_go
    assert merged > cells_of(rest)


def test_work_done_again_adds_equal_cells_only(tmp_path: Path) -> None:
    segments = [record(tmp_path / "0.rrd", range(4)), record(tmp_path / "1.rrd", range(2, 6))]
    merge_segments(segments, tmp_path / "merged.rrd")
    in_one_go = cells_of(whole(tmp_path / "whole.rrd", range(6)))
    assert set(cells_of(tmp_path / "merged.rrd")) == set(in_one_go)


def test_nothing_to_merge_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "empty.rrd").touch()
    with pytest.raises(ProgroundError, match="no telemetry to merge"):
        merge_segments([tmp_path / "empty.rrd"], tmp_path / "merged.rrd")
    (tmp_path / "other.rrd").write_text("not a recording")
    with pytest.raises(ProgroundError, match="cannot be merged"):
        merge_segments([tmp_path / "other.rrd"], tmp_path / "merged.rrd")
    assert not (tmp_path / "merged.rrd").exists()
