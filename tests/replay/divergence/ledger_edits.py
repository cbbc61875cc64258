"""Copies of a run whose ledger was changed on purpose, and sealed again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from proground_log.run.folder import RunFolder
from proground_log.run.ledger import FIRST_SEAL, read_ledger, seal

Entry = dict[str, Any]


def write_sealed(path: Path, entries: Iterable[Entry]) -> None:
    """Write a ledger as any version would: each line carries the seal of the one before."""
    after, lines = FIRST_SEAL, []
    for entry in entries:
        lines.append(json.dumps({**entry, "after": after}, separators=(",", ":")))
        after = seal(lines[-1])
    path.write_text("".join(line + "\n" for line in lines))


def edited_run(run: Path, copy: Path, edit: Callable[[list[Entry]], Iterable[Entry]]) -> Path:
    """A copy of a run with another ledger."""
    shutil.copytree(run, copy)
    ledger = RunFolder(copy).ledger
    write_sealed(ledger, edit(list(read_ledger(ledger))))
    return copy


def without_frame(entries: Iterable[Entry], frame: int) -> Iterator[Entry]:
    """A ledger as if the frame had been dropped; the steps after it are counted on."""
    missing = 0
    for entry in entries:
        if entry.get("frame") != frame:
            yield {**entry, "step": entry["step"] - missing} if "step" in entry else entry
        elif entry["event"] == "frame":
            yield {"event": "dropped", "frame": frame, "sim_time_ns": 7, "reason": "drop-oldest"}
        elif entry["event"] == "step":
            missing += 1
