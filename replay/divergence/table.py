"""All that differs between two ledgers, and where it begins: a table."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from replay.divergence.divergence import (
    CAUSES,
    LASTING,
    UNKNOWN,
    Entry,
    field_differences,
    with_last_step,
)


@dataclass(frozen=True)
class DifferenceRow:
    """Something that differs.

    Args:
        cause: as in a `Divergence`.
        name: the field, loss or tensor.
        lines: ledger lines in which it differs.
        frame, step: where it does first, by the first ledger; None where it names none.
        ulp: the largest distance; None where the ledger has fingerprints alone.
    """

    cause: str
    name: str
    lines: int
    frame: int | None
    step: int | None
    ulp: int | None


def difference_table(first: Iterable[Entry], second: Iterable[Entry]) -> list[DifferenceRow]:
    """Compare two ledgers line by line, causes first.

    Lines are matched by frame and by step of the frame, so that a frame that one run dropped does
    not make all that follows differ; the running number of a step is left out.
    """
    counterparts = _by_moment(second)
    rows: dict[tuple[str, str], DifferenceRow] = {}

    def count(cause: str, name: str, entry: Entry, ulp: int | None = None) -> None:
        row = rows.get((cause, name))
        if row is None:
            frame, step = entry.get("frame"), entry.get("step")
            row = DifferenceRow(cause, name, 0, frame, step, ulp)
        elif ulp is not None:
            ulp = max(ulp, row.ulp or 0)
        rows[cause, name] = dataclasses.replace(row, lines=row.lines + 1, ulp=ulp)

    def lonely_line(entry: Entry, whose: str) -> None:
        if entry["event"] != "state":  # How often there is one is a setting that touches nothing.
            cause = "schedule" if entry["event"] in LASTING else UNKNOWN
            count(cause, f"event {entry['event']} only in the {whose}", entry)

    for moment, entry in _by_moment(first).items():
        counterpart = counterparts.pop(moment, None)
        if counterpart is None:
            lonely_line(entry, "first")
            continue
        found, lonely = field_differences(_without_number(entry), _without_number(counterpart))
        for difference in found:
            count(difference.cause, difference.name, entry, difference.ulp)
        for name in lonely:
            count(UNKNOWN, name, entry)
    for entry in counterparts.values():
        lonely_line(entry, "second")
    order = [*dict.fromkeys(CAUSES.values()), UNKNOWN]
    return sorted(rows.values(), key=lambda row: order.index(row.cause))


def _by_moment(entries: Iterable[Entry]) -> dict[tuple[object, ...], Entry]:
    """Entries by what they tell of; a state by the frame and iteration of its step."""
    found: dict[tuple[object, ...], Entry] = {}
    seen: Counter[tuple[object, ...]] = Counter()
    for entry, step in with_last_step(entries):
        at = step if entry["event"] == "state" and step is not None else entry
        moment = (entry["event"], at.get("frame"), at.get("iteration"))
        seen[moment] += 1
        place: Entry = {name: at[name] for name in ("frame", "step") if name in at}
        found[*moment, seen[moment]] = {**entry, **place}
    return found


def _without_number(entry: Entry) -> Entry:
    return {name: value for name, value in entry.items() if name != "step"}
