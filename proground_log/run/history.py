"""What a ledger says of a run, as curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.run.ledger import bits_float, read_ledger

NS_PER_S, NS_PER_MS = 1e9, 1e6


@dataclass(frozen=True)
class History:
    """A run from its first line to its last.

    Args:
        losses: by term, float64 [steps], in the order in which the terms first came.
        done_s: simulated time at which each mapped frame was done, float64 [F].
        spent_ms: by stage, what each mapped frame spent on it, float64 [F].
        lag_s: from each mapped frame's arrival to the end of its turn, float64 [F].
        waiting: frames that waited when each mapped frame was taken, int64 [F].
        steps: steps of each mapped frame, int64 [F].
        dropped_s: simulated time of each drop, float64 [D].
        samples, keyframes: of the buffer after each frame, int64 [T].
        buffer: the buffer's last figures by name.
        semantics: those of the memory of meaning; None where no meaning was learnt.
    """

    losses: dict[str, np.ndarray]
    done_s: np.ndarray
    spent_ms: dict[str, np.ndarray]
    lag_s: np.ndarray
    waiting: np.ndarray
    steps: np.ndarray
    dropped_s: np.ndarray
    samples: np.ndarray
    keyframes: np.ndarray
    buffer: Mapping[str, Any]
    semantics: Mapping[str, Any] | None


def read_history(ledger: Path) -> History:
    """Read a whole ledger; raises a ProgroundError at a line whose seal is broken."""
    losses: dict[str, list[float]] = {}
    entries: dict[str, list[dict[str, Any]]] = {"scheduled": [], "dropped": [], "done": []}
    for entry in read_ledger(ledger):
        if entry["event"] == "step":
            for name, bits in entry["losses"].items():
                losses.setdefault(name, []).append(bits_float(bits))
        elif entry["event"] in entries:
            entries[entry["event"]].append(entry)
    scheduled, done = entries["scheduled"], entries["done"]
    ended_ns = np.array([entry["sim_time_ns"] for entry in scheduled], np.int64)
    arrived_ns = np.array([entry["arrived_ns"] for entry in scheduled], np.int64)
    stages = dict.fromkeys(stage for entry in scheduled for stage in entry["spans"])
    return History(
        losses={name: np.array(values) for name, values in losses.items()},
        done_s=ended_ns / NS_PER_S,
        spent_ms={
            stage: np.array([_length_ns(entry["spans"].get(stage)) for entry in scheduled])
            / NS_PER_MS
            for stage in stages
        },
        lag_s=(ended_ns - arrived_ns) / NS_PER_S,
        waiting=np.array([entry["waiting"] for entry in scheduled], np.int64),
        steps=np.array([entry["steps"] for entry in scheduled], np.int64),
        dropped_s=np.array([entry["sim_time_ns"] for entry in entries["dropped"]]) / NS_PER_S,
        samples=np.array([entry["buffer"]["samples"] for entry in done], np.int64),
        keyframes=np.array([entry["buffer"]["keyframes"] for entry in done], np.int64),
        buffer=done[-1]["buffer"] if done else {},
        semantics=done[-1]["semantics"] if done else None,
    )


def _length_ns(span: list[int] | None) -> int:
    return 0 if span is None else span[1] - span[0]
