"""A replay that was interrupted, or killed, and resumed leaves one recording."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import pytest
import telemetry_stream as stream
from rerun.chunk import RrdReader
from telemetry_cells import cells_of

from proground_log.errors import ProgroundError
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments

KILLED = """
import os, signal, sys
from pathlib import Path
import telemetry_stream as stream
from proground_log.telemetry.rerun_sink import TelemetrySink

sink = TelemetrySink(Path(sys.argv[1]), recording_id="run")
for event in stream.of_frames(range(3)):
    sink.on_event(event)
sink.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def record(path: Path, frames: range, *, finish: bool = False) -> Path:
    first = frames.start
    sink = TelemetrySink(
        path,
        recording_id="run",
        steps_done=first * stream.STEPS_PER_FRAME,
        last_position_m=stream.position_m(first - 1) if first else None,
    )
    for event in stream.of_frames(frames):
        sink.on_event(event)
    if finish:
        sink.on_event(stream.FINISHED)
    sink.close()
    return path


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    path = tmp_path / "killed.rrd"
    here = Path(__file__).parent
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], cwd=here, check=False)
    assert done.returncode == -9
    with pytest.warns(Warning, match="no footer"):
        RrdReader(path)
    return path


def test_segments_make_the_recording_that_one_go_makes(tmp_path: Path) -> None:
    whole = record(tmp_path / "whole.rrd", range(6), finish=True)
    segments = [
        record(tmp_path / "0.rrd", range(2)),
        record(tmp_path / "1.rrd", range(2, 4)),
        record(tmp_path / "2.rrd", range(4, 6), finish=True),
    ]
    merge_segments(segments, tmp_path / "merged.rrd")
    assert cells_of(tmp_path / "merged.rrd") == cells_of(whole)


def test_a_killed_segment_merges(tmp_path: Path, killed: Path) -> None:
    rest = record(tmp_path / "rest.rrd", range(3, 6), finish=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        merge_segments([killed, rest], killed)
        merged = cells_of(killed)
        assert RrdReader(killed).blueprints()
    assert merged == cells_of(record(tmp_path / "whole.rrd", range(6), finish=True))


def test_a_segment_torn_in_a_message_keeps_what_precedes_it(tmp_path: Path, killed: Path) -> None:
    torn = tmp_path / "torn.rrd"
    torn.write_bytes(killed.read_bytes()[:-700])
    rest = record(tmp_path / "rest.rrd", range(3, 6))
    merge_segments([torn, rest], tmp_path / "merged.rrd")
    whole = cells_of(record(tmp_path / "whole.rrd", range(6)))
    merged = cells_of(tmp_path / "merged.rrd")
    assert merged <= whole
    assert merged > cells_of(rest)


def test_work_done_again_adds_equal_cells_only(tmp_path: Path) -> None:
    segments = [record(tmp_path / "0.rrd", range(4)), record(tmp_path / "1.rrd", range(2, 6))]
    merge_segments(segments, tmp_path / "merged.rrd")
    whole = cells_of(record(tmp_path / "whole.rrd", range(6)))
    assert set(cells_of(tmp_path / "merged.rrd")) == set(whole)


def test_nothing_to_merge_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "empty.rrd").touch()
    with pytest.raises(ProgroundError, match="no telemetry to merge"):
        merge_segments([tmp_path / "empty.rrd"], tmp_path / "merged.rrd")
    (tmp_path / "other.rrd").write_text("not a recording")
    with pytest.raises(ProgroundError, match="cannot be merged"):
        merge_segments([tmp_path / "other.rrd"], tmp_path / "merged.rrd")
    assert not (tmp_path / "merged.rrd").exists()
