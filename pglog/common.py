"""What the commands share: arguments, exit codes, tables and progress."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args

import tyro
from rich.console import Console
from rich.table import Column, Table
from tyro.conf import Positional
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
    UnsupportedTypeAnnotationError,
)

from proground_log.locations import located

if TYPE_CHECKING:
    from proground_log.events import Sink

SAME, DIFFERENT, FAILED, STOPPED = 0, 1, 2, 130
"""Exit codes; STOPPED is what a shell expects after Ctrl-C."""

# Names of files are printed as they are: "[room]" is no markup, ":cat:" no picture.
out = Console(markup=False, emoji=False, highlight=False)
err = Console(stderr=True)


Log = Annotated[Path, Positional, tyro.conf.arg(metavar="LOG")]
Run = Annotated[Path, Positional, tyro.conf.arg(metavar="RUN")]
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
AsJson = Annotated[bool, tyro.conf.arg(name="json")]

REGISTRY = ConstructorRegistry()
"""How arguments are read, by their types."""
NO_DEFAULT_SHOWN = tyro.conf.arg(help_behavior_hint="")
"""Of an argument that is nothing unless it is given: "(default: None)" says nothing."""


@REGISTRY.primitive_rule
def _path(kind: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """A path may be a URL."""
    if kind.type is not Path:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="PATH",
        instance_from_str=lambda texts: located(texts[0]),
        is_instance=lambda value: hasattr(value, "read_bytes"),
        str_from_instance=lambda path: [str(path)],
    )


@REGISTRY.primitive_rule
def _text(kind: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    if kind.type is not str:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="TEXT",
        instance_from_str=lambda texts: texts[0],
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda text: [text],
    )


@REGISTRY.primitive_rule
def _optional(
    kind: PrimitiveTypeInfo,
) -> PrimitiveConstructorSpec[Any] | UnsupportedTypeAnnotationError | None:
    """What may be left out is written as if it could not: None is no word of a command line."""
    given = [each for each in get_args(kind.type) if each is not type(None)]
    if kind.type_origin not in (Union, UnionType) or len(given) != 1:
        return None
    inner = PrimitiveTypeInfo.make(given[0], kind.markers)
    spec = ConstructorRegistry.get_primitive_spec(inner)
    if not isinstance(spec, PrimitiveConstructorSpec):
        return spec
    return dataclasses.replace(
        spec,
        is_instance=lambda value: value is None or spec.is_instance(value),
        str_from_instance=lambda value: [] if value is None else spec.str_from_instance(value),
    )


class _PartsRule:
    """Fields of settings that are nothing unless they are given: help says no default of them."""

    def __init__(self) -> None:
        self._is_asking = False

    def __call__(self, kind: StructTypeInfo) -> StructConstructorSpec | None:
        if self._is_asking or not dataclasses.is_dataclass(kind.type):
            return None
        self._is_asking = True  # The usual rule answers, rather than this one again.
        try:
            spec = ConstructorRegistry.get_struct_spec(kind)
        finally:
            self._is_asking = False
        if not isinstance(spec, StructConstructorSpec):
            return None
        return dataclasses.replace(spec, fields=tuple(map(self._quiet, spec.fields)))

    def _quiet(self, field: StructFieldSpec) -> StructFieldSpec:
        shown: Any = quiet(field.type, field.default)
        return dataclasses.replace(field, type=shown)


REGISTRY.struct_rule(_PartsRule())


def quiet(kind: Any, default: object) -> Any:
    """The type of an argument, whose default the help leaves out where it is nothing."""
    is_nothing = default is None or default is False or default == ()
    return Annotated[kind, NO_DEFAULT_SHOWN] if is_nothing else kind


@contextmanager
def shown_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar; it appears when it is first told how many are done, and of how many."""
    from pglog.progress import progress_bar

    bar = progress_bar(err)
    task = bar.add_task(what, total=None, note="")

    def move(done: int, total: int) -> None:
        bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield move
    finally:
        if bar.live.is_started:
            bar.stop()


def frames_watched(frames: int) -> list[Sink]:
    """A bar for a replay with so many frames to come, as its only watcher."""
    from pglog.progress import ProgressSink

    return [ProgressSink(frames, err)]


def warn(warning: str) -> None:
    """Say what looks wrong, though the command goes on."""
    print(f"pglog: warning: {warning}", file=sys.stderr)


def print_table(title: str, rows: dict[str, str]) -> None:
    table = Table(Column(overflow="fold"), Column(overflow="fold"), show_header=False)
    for name, value in rows.items():
        table.add_row(name, value)
    print(title)
    out.print(table)
