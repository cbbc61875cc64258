"""What a ledger says of a run, as curves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.run.ledger import bits_float, float_bits, read_ledger

NS_PER_S, NS_PER_MS = 1e9, 1e6


@dataclass(frozen=True)
class History:
    """A run from its first line to its last.

    Args:
        losses: by term, float32 [S], in the order in which the terms first came; nan where a step
            had no such term.
        step, step_frame, step_ns: of each step its number, that of the newest frame, and its
            simulated time, int64 [S].
        done_s: simulated time at which each mapped frame was done, float64 [F].
        spent_ms: by stage, what each mapped frame spent on it, float64 [F].
        lag_s: from each mapped frame's arrival to the end of its turn, float64 [F].
        waiting: frames that waited when each mapped frame was taken, int64 [F].
        steps: steps of each mapped frame, int64 [F].
        dropped_s: simulated time of each drop, float64 [D].
        counts: what the mapper held after each frame: by group, each figure that is a number,
            int64 [T].
        held: what it held at last, as `events.Counts`, groups that stayed empty left out.
    """

    losses: dict[str, np.ndarray]
    step: np.ndarray
    step_frame: np.ndarray
    step_ns: np.ndarray
    done_s: np.ndarray
    spent_ms: dict[str, np.ndarray]
    lag_s: np.ndarray
    waiting: np.ndarray
    steps: np.ndarray
    dropped_s: np.ndarray
    counts: Mapping[str, Mapping[str, np.ndarray]]
    held: Mapping[str, Mapping[str, Any]]


def read_history(ledger: Path) -> History:
    """Read a whole ledger; raises a ProgroundError at a line whose seal is broken."""
    kinds = ("step", "scheduled", "dropped", "done")
    entries: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    for entry in read_ledger(ledger):
        if entry["event"] in entries:
            entries[entry["event"]].append(entry)
    steps, scheduled, done = entries["step"], entries["scheduled"], entries["done"]
    terms = dict.fromkeys(name for step in steps for name in step["losses"])
    nothing = float_bits(math.nan)
    ended_ns = np.array([entry["sim_time_ns"] for entry in scheduled], np.int64)
    arrived_ns = np.array([entry["arrived_ns"] for entry in scheduled], np.int64)
    last = done[-1] if done else {}
    held = {group: figures for group, figures in last.items() if isinstance(figures, dict)}
    stages = dict.fromkeys(stage for entry in scheduled for stage in entry["spans"])
    return History(
        losses={
            name: np.array(
                [bits_float(step["losses"].get(name, nothing)) for step in steps], np.float32
            )
            for name in terms
        },
        step=np.array([step["step"] for step in steps], np.int64),
        step_frame=np.array([step["frame"] for step in steps], np.int64),
        step_ns=np.array([step["sim_time_ns"] for step in steps], np.int64),
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
        counts={
            group: {
                name: np.array([entry[group][name] for entry in done], np.int64)
                for name, value in figures.items()
                if isinstance(value, int)
            }
            for group, figures in held.items()
        },
        held=held,
    )


def _length_ns(span: list[int] | None) -> int:
    return 0 if span is None else span[1] - span[0]
