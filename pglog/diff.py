"""The command that tells two runs apart: diff."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Column, Table

from pglog.common import DIFFERENT, SAME, AsJson, Run, out

if TYPE_CHECKING:
    from replay.divergence.diff import Comparison
    from replay.divergence.divergence import Divergence
    from replay.divergence.table import DifferenceRow


def diff_command(
    first: Run,
    second: Run,
    *,
    every: Annotated[bool, tyro.conf.arg(name="all")] = False,
    as_json: AsJson = False,
) -> int:
    """Name the first step at which two runs differ, and in what. Exit code 1 if they do.

    Exit code 2 if they cannot be compared: no finished runs, other logs, no frame in common.

    Args:
        first: folder of a run.
        second: folder of another.
        every: show all that differs, matched by frame and step, not the first difference alone.
        as_json: print JSON, for programs.
    """
    from replay.divergence.diff import compare_all, compare_runs

    comparison = compare_runs(first, second)
    rows = compare_all(first, second) if every else None
    if as_json:
        print(json.dumps(_content(comparison, rows), indent=2))
    else:
        _print(comparison, rows)
    return SAME if comparison.is_same else DIFFERENT


def _content(comparison: Comparison, rows: list[DifferenceRow] | None) -> dict[str, object]:
    content = {"same": comparison.is_same, **dataclasses.asdict(comparison)}
    if rows is not None:
        content["all"] = [dataclasses.asdict(row) for row in rows]
    return content


def _print(comparison: Comparison, rows: list[DifferenceRow] | None) -> None:
    for origin in comparison.origins:
        print(origin)
    for name in comparison.passed_over:
        print(f"not compared: {name}")
    if comparison.divergence is not None:
        print_divergence(comparison.divergence, comparison.origins)
    if rows:
        _print_rows(rows)
    for name, difference in comparison.tensors.items():
        print(f"final {name}: {difference}")
    if comparison.is_same:
        print("the runs are equal, bit for bit")


def print_divergence(divergence: Divergence, origins: list[str]) -> None:
    """Say where two ledgers part ways, and in what."""
    if not origins:
        print("nothing that made the runs differs: the replay did not repeat itself")
    print(
        f"first difference: {divergence.cause}, at frame {divergence.frame}, "
        f"step {divergence.step} (ledger line {divergence.line})"
    )
    for detail in divergence.details:
        print(f"  {detail}")


def _print_rows(rows: list[DifferenceRow]) -> None:
    what = Column("what", overflow="fold")
    table = Table("cause", what, "lines", "from frame", "step", "most ulp")
    for column in table.columns[2:]:
        column.justify = "right"
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in dataclasses.astuple(row)))
    out.print(table)
