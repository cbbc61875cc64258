"""The first difference between two ledgers, found entry by entry.

Ledgers of different versions are compared as far as both go: an event that only one version
writes, and a field that only one has, are passed over and named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from proground_log.run.ledger import bits_float
from replay.divergence.distance import ulp_distance

Entry = dict[str, Any]

CAUSES = {
    **dict.fromkeys(("event", "frame", "step", "iteration"), "schedule"),
    **dict.fromkeys(("input", "stamp_ns"), "input"),
    **dict.fromkeys(("held_out", "reason", "begin_ns", "arrived_ns", "sim_time_ns"), "schedule"),
    **dict.fromkeys(("idle_ns", "waiting", "steps", "overrun_ns", "spans"), "schedule"),
    "draws": "random draw",
    "losses": "loss",
    "digests": "state",
    **dict.fromkeys(("buffer", "inserted", "evicted", "semantics"), "buffer"),
}
"""What a differing field of a ledger's entry means; the order is that of cause and effect."""

UNKNOWN = "unknown field"
"""The cause where a field differs that this version does not know."""

LASTING = ("frame", "dropped", "regions", "keyframe", "step", "done")
"""Events that every version writes, if they happen; one without a counterpart is a difference."""

OPEN = ("losses", "digests", "spans")
"""Fields whose keys are names of things; in any other, keys are the version's."""

SETTINGS = ("capacity",)
"""Keys that repeat a setting; the manifests tell whether it differs."""

ABSENT = "absent"
MUST_MATCH = 3, 0
"""The highest rank: of an event that every version writes, and of a ledger's end."""


@dataclass(frozen=True)
class Divergence:
    """The first difference between two ledgers.

    Args:
        line: of the first ledger, from 1.
        frame: number of the frame in its log, as far as the first ledger tells.
        step: number of the last step, likewise; None before the first.
        cause: input, schedule, random draw, loss, state, buffer or unknown field.
        details: what differs, a line each, with the distance in ulp where it is a number.
    """

    line: int
    frame: int | None
    step: int | None
    cause: str
    details: list[str]


@dataclass(frozen=True)
class FieldDifference:
    """A field of two entries that differs.

    Args:
        field, key: its name, and the key in it where it has some.
        first, second: what it is; "absent" for a key that only one has.
    """

    field: str
    key: str | None
    first: object
    second: object

    @property
    def cause(self) -> str:
        """What it means, as in `CAUSES`."""
        return CAUSES.get(self.field, UNKNOWN)

    @property
    def name(self) -> str:
        """What it is called."""
        if self.key is None:
            return self.field
        prefix = {"losses": "loss ", "digests": "tensor "}.get(self.field, f"{self.field}.")
        return prefix + self.key

    @property
    def ulp(self) -> int | None:
        """Float32 values between the two; None where they are no losses."""
        if self.field != "losses" or ABSENT in (self.first, self.second):
            return None
        return ulp_distance(*(np.float32(bits_float(str(x))) for x in (self.first, self.second)))

    def __str__(self) -> str:
        if self.ulp is None:
            return f"{self.name}: {self.first} | {self.second}"
        x, y = bits_float(str(self.first)), bits_float(str(self.second))
        return f"{self.name}: {x:.9g} | {y:.9g} ({self.ulp} ulp)"


def field_differences(a: Entry, b: Entry) -> tuple[list[FieldDifference], list[str]]:
    """What differs between two entries of a kind, causes before effects, and what only one has."""
    found: list[FieldDifference] = []
    lonely: list[str] = []
    for name in [*a, *(name for name in b if name not in a)]:
        first, second = a.get(name, ABSENT), b.get(name, ABSENT)
        if name not in a or name not in b:
            lonely.append(_lonely(f"{a['event']}.{name}", name in a))
        elif first == second:
            continue
        elif isinstance(first, dict) and isinstance(second, dict):
            for key in [*first, *(key for key in second if key not in first)]:
                x, y = first.get(key, ABSENT), second.get(key, ABSENT)
                if name not in OPEN and (key not in first or key not in second):
                    lonely.append(_lonely(f"{a['event']}.{name}.{key}", key in first))
                elif x != y and key not in SETTINGS:
                    found.append(FieldDifference(name, key, x, y))
        else:
            found.append(FieldDifference(name, None, first, second))
    order = list(CAUSES)
    found.sort(key=lambda d: order.index(d.field) if d.field in order else len(order))
    return found, lonely


def _lonely(what: str, is_first: bool) -> str:
    return f"{what} is only in the {'first' if is_first else 'second'}"


class LedgerComparison:
    """Compares entries, as they come, with a reference ledger.

    `passed_over` says what was left out since only one of the two has it.

    Args:
        reference: the first ledger's entries.
    """

    def __init__(self, reference: Iterable[Entry]) -> None:
        self._reference = iter(reference)
        self._next: Entry | None = None
        self._line = 0
        self._frame: int | None = None
        self._step: int | None = None
        self._passed: dict[str, None] = {}
        self._advance()

    @property
    def passed_over(self) -> list[str]:
        """What only one of the two has, in the order it was met."""
        return list(self._passed)

    def compare(self, entry: Entry) -> Divergence | None:
        """Compare the second ledger's next entry; the difference where there is one."""
        while not _are_alike(self._next, entry):
            if min(_rank(self._next), _rank(entry)) == MUST_MATCH:
                return self._of_events(self._next, entry)
            if _rank(entry) <= _rank(self._next):
                self._pass_over(entry, is_first=False)
                return None
            self._pass_over(self._next, is_first=True)
            self._advance()
        assert self._next is not None
        found, lonely = field_differences(self._next, entry)
        self._passed |= dict.fromkeys(lonely)
        if found:
            return self._divergence(found[0].cause, [str(difference) for difference in found])
        self._advance()
        return None

    def end(self) -> Divergence | None:
        """The second ledger has ended; the difference where the first goes on."""
        while _rank(self._next) != MUST_MATCH:
            self._pass_over(self._next, is_first=True)
            self._advance()
        return None if self._next is None else self._of_events(self._next, None)

    def _advance(self) -> None:
        self._next = next(self._reference, None)
        self._line += 1
        if self._next is not None:
            self._frame = self._next.get("frame", self._frame)
            # The digest after a step counts the steps done, and belongs to the last of them.
            done = self._next["event"] == "state"
            if "step" in self._next and not (done and not self._next["step"]):
                self._step = self._next["step"] - done

    def _pass_over(self, entry: Entry | None, *, is_first: bool) -> None:
        # How often the state is digested is a setting that touches nothing; not worth a word.
        if entry is not None and entry["event"] != "state":
            self._passed[_lonely(f"event {entry['event']}", is_first)] = None

    def _of_events(self, first: Entry | None, second: Entry | None) -> Divergence:
        titles = [f"{whose}: {_title(e)}" for whose, e in (("first", first), ("second", second))]
        return self._divergence("schedule", titles)

    def _divergence(self, cause: str, details: list[str]) -> Divergence:
        return Divergence(self._line, self._frame, self._step, cause, details)


def first_divergence(
    first: Iterable[Entry], second: Iterable[Entry]
) -> tuple[Divergence | None, list[str]]:
    """The first difference of two ledgers, and what was passed over up to there."""
    comparison = LedgerComparison(first)
    found = (comparison.compare(entry) for entry in second)
    divergence = next((d for d in found if d is not None), None) or comparison.end()
    return divergence, comparison.passed_over


def with_last_step(entries: Iterable[Entry]) -> Iterator[tuple[Entry, Entry | None]]:
    """Each entry with the newest step up to it, itself included; None before the first."""
    step = None
    for entry in entries:
        if entry["event"] == "step":
            step = entry
        yield entry, step


def _are_alike(first: Entry | None, second: Entry) -> bool:
    """Whether two entries tell of the same kind of event, and of the same moment's state."""
    if first is None or first["event"] != second["event"]:
        return False
    return first["event"] != "state" or first["step"] == second["step"]


def _rank(entry: Entry | None) -> tuple[int, int]:
    """Of two entries that do not match, the one with the lower rank is passed over."""
    match entry:
        case {"event": "state", "step": step}:
            return 0, step
        case {"event": "scheduled"}:
            return 2, 0
        case {"event": event} if event not in LASTING:
            return 1, 0
    return MUST_MATCH


def _title(entry: Entry | None) -> str:
    """What an entry tells, in a few words."""
    if entry is None:
        return "the run ends here"
    parts = [f"{name} {entry[name]}" for name in ("frame", "step", "reason") if name in entry]
    return ", ".join([f"event {entry['event']}", *parts])
