"""What the commands share: arguments, exit codes, tables and progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.table import Column, Table
from tyro.conf import Positional
from tyro.constructors import PrimitiveConstructorSpec

from proground_log.locations import located

if TYPE_CHECKING:
    from proground_log.events import Sink

SAME, DIFFERENT, FAILED, STOPPED = 0, 1, 2, 130
"""Exit codes; STOPPED is what a shell expects after Ctrl-C."""

# Names of files are printed as they are: "[room]" is no markup, ":cat:" no picture.
out = Console(markup=False, emoji=False, highlight=False)
err = Console(stderr=True)


def _place(metavar: str) -> PrimitiveConstructorSpec[Any]:
    """How an argument that may be a URL is read."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: located(texts[0]),
        is_instance=lambda value: value is None or hasattr(value, "read_bytes"),
        str_from_instance=lambda path: [str(path)],
    )


Log = Annotated[Path, Positional, _place("LOG")]
MaybePath = Annotated[Path | None, _place("PATH"), tyro.conf.arg(help_behavior_hint="")]
MaybeLog = Annotated[Path | None, Positional, _place("LOG"), tyro.conf.arg(help_behavior_hint="")]
MaybeSource = Annotated[
    Path | None, Positional, _place("SOURCE"), tyro.conf.arg(help_behavior_hint="")
]
LogsAndRuns = Annotated[
    tuple[Annotated[Path, _place("LOG|RUN")], ...],
    Positional,
    tyro.conf.arg(help_behavior_hint=""),
]
Run = Annotated[Path, Positional, tyro.conf.arg(metavar="RUN")]
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"]), _place("PATH")]
AsJson = Annotated[bool, tyro.conf.arg(name="json")]
MaybeInt = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]
MaybeFloat = Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")]
MaybeText = Annotated[str | None, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")]


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
