from __future__ import annotations

from pathlib import Path

import pytest

from tests.commands import Pglog


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_a_data_set_is_not_overwritten_with_its_log(
    pglog: Pglog, tmp_path: Path, overwrite: tuple[str, ...]
) -> None:
    bag = tmp_path / "bag.mcap"
    bag.write_bytes(b"hours of work")
    answer = pglog("record", "ros2-bag", bag, "-o", tmp_path / "." / "bag.mcap", *overwrite)
    assert answer.code == 2
    assert "bag.mcap: the output is the data set to record; choose another name" in answer.err
    assert bag.read_bytes() == b"hours of work"


def test_auto_says_that_a_log_is_one_already(pglog: Pglog, room_log: Path, tmp_path: Path) -> None:
    answer = pglog("record", "auto", room_log, "-o", tmp_path / "a.mcap")
    assert answer.code == 2
    assert "room.mcap: is a log of pglog already; use it as it is" in answer.err
