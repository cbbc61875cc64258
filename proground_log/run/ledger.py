"""The ledger: one line for everything that happened, each sealed by the one before."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from proground_log.errors import ProgroundError
from proground_log.events import (
    Event,
    FrameArrived,
    FrameDone,
    FrameDropped,
    FrameScheduled,
    KeyframeInserted,
    RegionsArrived,
    StateDigested,
    StepDone,
)
from proground_log.files import disk_errors, require_file

FIRST_SEAL = "0" * 32


def float_bits(value: float) -> str:
    """A float32's bits, hexadecimal, so that a ledger compares exactly."""
    return struct.pack(">f", value).hex()


def bits_float(bits: str) -> float:
    """The float32 of these bits."""
    return float(struct.unpack(">f", bytes.fromhex(bits))[0])


def seal(line: str) -> str:
    """Fingerprint of a line, which the next one carries."""
    return hashlib.sha256(line.encode()).hexdigest()[:32]


def entry_of(event: Event) -> dict[str, Any] | None:
    """What the ledger keeps of an event; None for what is only for the eye."""
    match event:
        case FrameArrived():
            return {
                "event": "frame",
                "frame": event.frame.index,
                "stamp_ns": event.frame.stamp_ns,
                "sim_time_ns": event.sim_time_ns,
                "input": event.input_digest,
                "held_out": event.held_out,
            }
        case FrameDropped():
            return {
                "event": "dropped",
                "frame": event.frame_index,
                "sim_time_ns": event.sim_time_ns,
                "reason": event.reason,
            }
        case RegionsArrived():
            return {
                "event": "regions",
                "frame": event.frame_index,
                "begin_ns": event.begin_ns,
                "sim_time_ns": event.sim_time_ns,
            }
        case FrameScheduled():
            return {
                "event": "scheduled",
                "frame": event.frame_index,
                "sim_time_ns": event.sim_time_ns,
                "arrived_ns": event.arrived_ns,
                "idle_ns": event.idle_ns,
                "waiting": event.waiting,
                "steps": event.steps,
                "overrun_ns": event.overrun_ns,
                "spans": {stage: list(span) for stage, span in event.spans.items()},
            }
        case KeyframeInserted():
            return {
                "event": "keyframe",
                "frame": event.frame_index,
                "inserted": event.inserted,
                "evicted": event.evicted,
            }
        case StepDone():
            return {
                "event": "step",
                "frame": event.frame_index,
                "step": event.step,
                "iteration": event.iteration,
                "sim_time_ns": event.sim_time_ns,
                "draws": event.draws_digest,
                "losses": {name: float_bits(value) for name, value in event.losses.items()},
            }
        case StateDigested():
            return {"event": "state", "step": event.step, "digests": event.digests}
        case FrameDone():
            return {
                "event": "done",
                "frame": event.frame_index,
                "steps": event.steps,
                "sim_time_ns": event.sim_time_ns,
                **event.counts,
            }
    return None


class LedgerSink:
    """Appends events to a ledger file.

    Args:
        path: the file.
        lines: lines already there that count; whatever follows them is cut off (what was done
            after the checkpoint that a resumed run goes on from).
    """

    def __init__(self, path: Path, lines: int = 0) -> None:
        self._path = path
        self.lines, self._seal = lines, FIRST_SEAL
        kept = ""
        if lines:
            kept_lines = path.read_text().splitlines()[:lines]
            if len(kept_lines) < lines:
                raise ProgroundError(
                    f"has {len(kept_lines)} lines, the checkpoint counts {lines}",
                    where=path,
                    todo="start the run again with --overwrite",
                )
            self._seal = seal(kept_lines[-1])
            kept = "".join(line + "\n" for line in kept_lines)
        with disk_errors(path):
            self._stream: TextIO = path.open("w")
            self._stream.write(kept)

    def on_event(self, event: Event) -> None:
        """Append the event's line."""
        entry = entry_of(event)
        if entry is None:
            return
        line = json.dumps({**entry, "after": self._seal}, separators=(",", ":"))
        self._seal = seal(line)
        self.lines += 1
        with disk_errors(self._path):
            self._stream.write(line + "\n")

    def flush(self) -> None:
        """Hand everything to the disk, as a checkpoint needs it."""
        with disk_errors(self._path):
            self._stream.flush()

    def close(self) -> None:
        """Flush and close."""
        with disk_errors(self._path):
            self._stream.close()


def read_ledger(path: Path) -> Iterator[dict[str, Any]]:
    """The entries of a ledger; raises a ProgroundError at a line whose seal is broken."""
    require_file(path)
    expected = FIRST_SEAL
    # What is no text is no line that follows from the one before, either.
    with path.open(errors="replace") as stream:
        for number, text in enumerate(stream, start=1):
            line = text.rstrip("\n")
            try:
                entry = json.loads(line)
            except ValueError:
                entry = {}
            if not isinstance(entry, dict) or entry.pop("after", None) != expected:
                raise ProgroundError(
                    "the line does not follow from the one before: the ledger was changed",
                    where=f"{path}, line {number}",
                    todo="run the replay again",
                )
            expected = seal(line)
            yield entry
