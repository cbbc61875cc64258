"""`pglog info` and `pglog check`, and logs that no command can read."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from proground_log.frame import Selection
from recorders.record import record
from tests.commands import Pglog, assert_one_clear_line
from tests.writers.small_source import SmallSource, with_frame, write_log


def test_faults_are_listed(pglog: Pglog, tmp_path: Path) -> None:
    source = SmallSource(5)
    broken = source.frame(3).color[:-100]
    frames = with_frame(source, 3, color=broken)
    log = write_log(tmp_path / "a.mcap", source, frames=frames, announced=7)
    answer = pglog("check", log)
    assert answer.code == 1
    assert answer.out.startswith(f"{log}: 2 faults\n")
    assert re.search(r"3 +│ /camera/color/image │ the png image is cut short", answer.out)
    assert "5 frames found, 7 announced" in answer.out
    answer = pglog("check", log, "--json")
    assert answer.code == 1
    assert json.loads(answer.out)[0] == {
        "frame": "3",
        "topic": "/camera/color/image",
        "what": "the png image is cut short or damaged",
    }


def test_one_fault_is_not_several(pglog: Pglog, tmp_path: Path) -> None:
    answer = pglog("check", write_log(tmp_path / "a.mcap", announced=6))
    assert "a.mcap: 1 fault\n" in answer.out


def test_names_are_printed_as_they_are(pglog: Pglog, tmp_path: Path) -> None:
    log = tmp_path / "[bold]room :cat:.mcap"
    write_log(log, SmallSource(2, notes={"[red]": ":dog: [/]"}))
    for command in ("info", "check"):
        assert str(log) in pglog(command, log).out
    assert "[red]" in pglog("info", log).out
    assert ":dog: [/]" in pglog("info", log).out


def test_info_shows_what_looks_wrong_about_a_recording(
    pglog: Pglog, small_log: Path, tmp_path: Path
) -> None:
    source = SmallSource(3, warnings=("the lens cap is on", "the floor is lava"))
    log = tmp_path / "odd.mcap"
    record(source, "odd", log, Selection(), overwrite=False, progress=lambda *_: None)
    rows = pglog("info", log).out.splitlines()
    (first,) = (n for n, row in enumerate(rows) if row.startswith("│ warnings"))
    assert "the lens cap is on" in rows[first]
    assert "the floor is lava" in rows[first + 1]
    assert "warnings" not in pglog("info", small_log).out
    shown = [json.loads(pglog("info", name, "--json").out)["warnings"] for name in (log, small_log)]
    assert shown == [["the lens cap is on", "the floor is lava"], []]


@pytest.mark.parametrize("columns", [20, 40, 80])
def test_narrow_terminals_lose_nothing(
    pglog: Pglog, small_log: Path, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    _, *lines = pglog("info", small_log).out.splitlines()  # The first is the path.
    assert max(map(len, lines)) <= columns
    assert "…" not in "".join(lines)


# Errors: one clear line, exit code 2, nothing half-written.


def reading_commands(path: Path, free: Path) -> list[list[object]]:
    return [
        ["info", path],
        ["check", path],
        ["replay", path, "-o", free],
        ["perceive", path, "--simulated", "-o", free],
        ["view", path],
    ]


def test_a_missing_log(pglog: Pglog, tmp_path: Path) -> None:
    *commands, view = reading_commands(tmp_path / "no.mcap", tmp_path / "run")
    for command in commands:
        assert_one_clear_line(pglog(*command), "no.mcap: no such file; check the path")
    assert_one_clear_line(pglog(*view), "no.mcap: no such log or run; check the path")
    assert_one_clear_line(pglog("view", tmp_path, tmp_path / "no"), "no: no such log or run")
    assert not (tmp_path / "run").exists()


def test_a_folder_in_place_of_a_log(pglog: Pglog, tmp_path: Path) -> None:
    for command in reading_commands(tmp_path, tmp_path / "run"):
        assert_one_clear_line(pglog(*command), f"{tmp_path}: ", "folder")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_log(pglog: Pglog, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_text("time,x\n" * 100)
    for command in reading_commands(log, tmp_path / "run")[:4]:
        assert_one_clear_line(pglog(*command), "a.mcap: is no MCAP file")


def test_a_log_that_was_cut_off(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(small_log.read_bytes()[:-500])
    for command in reading_commands(log, tmp_path / "run")[:4]:
        assert_one_clear_line(pglog(*command), "a.mcap: the file is cut off; copy or record it")
    assert list(tmp_path.iterdir()) == [log]


def test_a_log_of_another_version(
    pglog: Pglog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("proground_log.log.recording.SCHEMA_VERSION", "9")
        log = write_log(tmp_path / "a.mcap")
    for command in reading_commands(log, tmp_path / "run")[:4]:
        answer = pglog(*command)
        assert_one_clear_line(answer, "the log has schema version 9, this pglog reads 1; record it")


def test_nothing_to_view(pglog: Pglog) -> None:
    assert_one_clear_line(pglog("view"), "there is nothing to open")


def test_a_reader_that_has_seen_enough(small_log: Path) -> None:
    command = [sys.executable, "-m", "pglog", "info", str(small_log), "--json"]
    read, write = os.pipe()
    os.close(read)  # As `head` does when it has its lines.
    try:
        result = subprocess.run(
            command, stdout=write, stderr=subprocess.PIPE, text=True, check=False
        )
    finally:
        os.close(write)
    assert result.stderr == ""
    assert result.returncode == 2
