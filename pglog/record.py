"""Command record: a command for each format, whose options are those of the format's class."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from collections.abc import Callable, Iterator
from inspect import Parameter, Signature, cleandoc, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tyro
from tyro.conf import Positional

from pglog.common import SAME, AsJson, Output, shown_progress, warn
from pglog.parsing import Group
from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.locations import is_same
from recorders.registry import AUTO, FORMATS, of_source, open_source

CALIBRATION, MOST_NAMED = "calibration", 5
OF_AUTO = "one of the others: finds out which, and says why"


def record_data_set(
    format: str,
    source: Path | None,
    *,
    output: Output,
    start: int = 0,
    stop: int | None = None,
    stride: int = 1,
    jobs: int | None = None,
    overwrite: bool = False,
    as_json: AsJson = False,
    calibration: Path | None = None,
    **options: object,
) -> int:
    """Turn a data set into a log.

    Args:
        format: its name, or "auto".
        source: the data set, a path or a URL.
        output: the log to write (.mcap).
        start: first frame.
        stop: frame to stop before.
        stride: take every so many-th frame.
        jobs: threads to read with; the log is the same for any number.
        overwrite: replace the output.
        as_json: print JSON, for programs.
        calibration: the rig, in place of what the format knows of it.
        options: the others of the format's class.
    """
    from recorders.calibration_file import read_calibration
    from recorders.record import record, require_output

    if source is not None and is_same(source, output):
        what, todo = "the output is the data set to record", "choose another name"
        raise ProgroundError(what, where=output, todo=todo)
    require_output(output, overwrite=overwrite)
    found = of_source(format, source)
    if format == AUTO:
        print(f"{source}: {found.format}, since it {found.reason}", file=sys.stderr)
    if calibration is not None:
        options[CALIBRATION] = read_calibration(calibration)
    opened = open_source(found.format, source, **options)
    name = found.format if source is None else _name(source)
    selection = Selection(start, stop, stride)
    with shown_progress("record") as progress:
        recording = record(
            opened, name, output, selection, overwrite=overwrite, progress=progress, jobs=jobs
        )
    for warning in recording.warnings:
        warn(warning)
    if as_json:
        print(json.dumps({"log": str(output), **dataclasses.asdict(recording)}, indent=2))
        return SAME
    size_mb = output.stat().st_size / 1e6
    print(f"{output}: {recording.frames} frames, {size_mb:.1f} MB")
    for keyword, note in recording.notes.items():
        print(f"  {keyword}: {note}")
    return SAME


def _name(source: Path) -> str:
    """What the log calls the source: its own name, also for "." and ".."."""
    return source.name if source.name not in ("", "..") else source.resolve().name


def format_command(name: str) -> Callable[..., int]:
    """The command that records a format, or finds out which."""
    takes_source = name == AUTO or FORMATS[name].takes_source
    common = {each.name: each for each in _parameters(record_data_set)}
    own = [_of_calibration(common[CALIBRATION])] if name == AUTO else list(_options(name))
    of_all = [common[each] for each in ("start", "stop", "stride", "jobs", "overwrite", "as_json")]
    parameters = [common["output"], *own, *of_all]
    if takes_source:
        source = common["source"]
        kind = Positional[Annotated[Path, *source.annotation.__metadata__]]
        parameters.insert(0, source.replace(annotation=kind))

    def command(source: Path | None = None, **given: Any) -> int:
        return record_data_set(name, source, **given)

    command.__doc__ = DESCRIPTIONS[name]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return command


def _options(name: str) -> Iterator[Parameter]:
    """What a format's class can be told, as arguments of a command."""
    for parameter in _parameters(FORMATS[name].opener()):
        if parameter.kind is Parameter.KEYWORD_ONLY:
            is_calibration = parameter.name == CALIBRATION
            yield _of_calibration(parameter) if is_calibration else parameter


def _of_calibration(parameter: Parameter) -> Parameter:
    """A calibration is given as the file that has it."""
    help = f"{parameter.annotation.__metadata__[-1].help} A JSON file, or a log of the same rig."
    kind: Any = Annotated[Path | None, tyro.conf.arg(help=help)]
    return parameter.replace(annotation=kind)


def _parameters(function: Callable[..., object]) -> Iterator[Parameter]:
    """The parameters of a function or class: their types with what its docstrings say of them."""
    documented: tuple[Callable[..., object], ...] = (function,)
    if isinstance(function, type):
        documented = (function, function.__init__)  # type: ignore[misc]
    initialiser = documented[-1]
    hints = get_type_hints(initialiser, include_extras=True)
    texts = dict(text for each in documented for text in _texts(each.__doc__ or ""))
    for name, parameter in signature(function).parameters.items():
        kind: Any = Annotated[hints[name], tyro.conf.arg(help=texts.get(name, ""))]
        yield parameter.replace(annotation=kind)


def _texts(docstring: str) -> Iterator[tuple[str, str]]:
    """What the Args of a docstring say, by name."""
    _, _, section = cleandoc(docstring).partition("Args:\n")
    section = re.split(r"^\S", section, maxsplit=1, flags=re.MULTILINE)[0]
    for names, text in re.findall(r"^ {4}(\w[\w, ]*): (.*(?:\n {8}.*)*)", section, re.MULTILINE):
        for name in names.split(", "):
            yield name, " ".join(text.split())


def _find_others(option: str) -> tuple[str, str] | None:
    """Which formats have an option, and what to do then; None if none has."""
    name = option.removeprefix("--").removeprefix("no-").replace("-", "_")
    having = [each for each in FORMATS if name in (option.name for option in _options(each))]
    if not 0 < len(having) <= MOST_NAMED:
        return None
    commands = " or ".join(f"`pglog record {each} ...`" for each in having)
    *first, last = having
    names = f"{', '.join(first)} and {last}" if first else last
    return f"{option} is of {names}", f"use {commands}"


DESCRIPTIONS = {AUTO: OF_AUTO} | {name: each.description for name, each in FORMATS.items()}
FORMAT_COMMANDS = Group(
    "Turn a data set into a log: pglog record FORMAT SOURCE -o LOG.",
    DESCRIPTIONS,
    format_command,
    _find_others,
)
