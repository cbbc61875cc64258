"""Recordings that are written in one go, or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest
import rerun as rr

from proground_log.errors import ProgroundError
from proground_log.telemetry.rerun_sink import recording_written
from tests.full_disk import largest_file
from tests.telemetry.telemetry_cells import rows_of


def write(path: Path, text: str) -> None:
    with recording_written(path, "an id") as recording:
        recording.log("note", rr.TextDocument(text), static=True)


def text_in(path: Path) -> str:
    ((_, (text,)),) = rows_of(path)["/note", "TextDocument:text"]
    return str(text)


def test_what_is_logged_replaces_the_file(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.rrd"
    for text in ("first", "second"):
        write(path, text)
        assert text_in(path) == text
    assert list(path.parent.iterdir()) == [path]


def test_an_error_and_a_full_disk_leave_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    write(path, "kept")
    with pytest.raises(ZeroDivisionError), recording_written(path, "an id") as recording:
        recording.log("note", rr.TextDocument(f"{1 / 0}"), static=True)
    with largest_file(1000), pytest.raises(ProgroundError, match=r"a\.rrd: cannot write"):
        write(path, "x" * 100_000)
    assert text_in(path) == "kept"
    assert list(tmp_path.iterdir()) == [path]
