"""What the commands say of themselves, and of a command line they cannot read."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest

from recorders.registry import FORMATS
from tests.commands import Answer, Pglog, assert_one_clear_line

COMMANDS = [
    *("record", "info", "check", "recover", "perceive", "vocabulary", "replay", "rerun", "diff"),
    *("bisect", "calibrate", "sweep", "ablate", "query", "objects", "navigate", "evaluate"),
    *("report", "export", "view", "demo"),
]


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help(pglog: Pglog, command: str | None) -> None:
    answer = pglog(*filter(None, [command]), "--help")
    assert (answer.code, answer.err) == (0, "")
    assert f"usage: pglog {command or '[-h]'}" in answer.out
    assert "STR" not in answer.out.splitlines()[0]
    assert "None" not in answer.out
    if command is None:
        assert all(name in answer.out for name in COMMANDS)


@pytest.mark.parametrize("arguments", [[], ["fly"], ["info"], ["info", "a", "b"], ["info", "--x"]])
def test_a_wrong_command_line(pglog: Pglog, arguments: list[str]) -> None:
    answer = pglog(*arguments)
    assert (answer.code, answer.out) == (2, "")
    assert "Traceback" not in answer.err
    assert "--help" in answer.err


def test_version(pglog: Pglog) -> None:
    assert "--version" in pglog("--help").out
    answer = pglog("--version")
    assert answer == Answer(0, f"proground-log {version('proground-log')}\n", "")


def test_help_of_a_command_in_a_command(pglog: Pglog) -> None:
    answer = pglog("vocabulary", "build", "--help")
    assert (answer.code, answer.err) == (0, "")
    assert "usage: pglog vocabulary build" in answer.out


def test_help_waits_for_nothing_heavy() -> None:
    program = "import sys, pglog.commands; print([m for m in sys.argv[1:] if m in sys.modules])"
    heavy = ["torch", "onnxruntime", "rerun", "numba", "mcap", "kornia", "skimage"]
    result = subprocess.run(
        [sys.executable, "-c", program, *heavy], capture_output=True, text=True, check=True
    )
    assert result.stdout == "[]\n"


@pytest.mark.parametrize("command", ["record", "replay", "export", "demo", "perceive"])
def test_a_missing_output_is_asked_for(pglog: Pglog, command: str) -> None:
    given = {"record": ["tum", "x"], "export": ["x", "mesh"], "demo": []}
    answer = pglog(command, *given.get(command, ["x"]))
    assert answer.code == 2
    assert "-o PATH, --output PATH" in answer.err


@pytest.mark.parametrize("format", ["auto", *FORMATS])
def test_help_of_a_format(pglog: Pglog, format: str) -> None:
    assert f" {format} " in pglog("record", "--help").out
    answer = pglog("record", format, "--help")
    assert (answer.code, answer.err) == (0, "")
    assert f"usage: pglog record {format} " in answer.out
    assert ("--color-topic" in answer.out) == (format in ("ros1-bag", "ros2-bag"))
    assert ("--calibration" in answer.out) == ("SOURCE" in answer.out) == (format != "synthetic")


def test_formats_are_listed_without_their_modules() -> None:
    program = (
        "import sys, pglog.commands\n"
        "sys.argv = ['pglog', 'record', '--help']\n"
        "try: pglog.commands.main()\n"
        "except SystemExit: print([m for m in sys.modules if m.startswith('recorders.formats')])"
    )
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.endswith("\n[]\n")


def test_typos_are_told_by_the_command_at_hand(pglog: Pglog) -> None:
    answer = pglog("replay", "--budgte-ms", 5)
    assert_one_clear_line(answer, "replay: there is no option --budgte-ms", "mean --budget-ms?")
    assert "sweep" not in answer.err
    for words in (["nonsense"], ["nonsense", "--help"], ["vocabulary", "nonsense", "--help"]):
        assert_one_clear_line(pglog(*words), "there is no `pglog", "nonsense`; the nearest are ")
    assert_one_clear_line(pglog("reply", "x"), "the nearest are replay,")
