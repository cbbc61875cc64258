"""Where two runs part ways: the first step that differs, and in what."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.mapping.map_file import load_map
from replay.ledger import bits_float, read_ledger
from replay.manifest import Manifest
from replay.run_folder import RunFolder

CAUSES = {
    "event": "schedule",
    "input": "input",
    "stamp_ns": "schedule",
    "sim_time_ns": "schedule",
    "held_out": "schedule",
    "frame": "schedule",
    "step": "schedule",
    "iteration": "schedule",
    "steps": "schedule",
    "draws": "random draw",
    "losses": "loss",
    "digests": "state",
    "buffer": "buffer",
    "inserted": "buffer",
    "evicted": "buffer",
}
"""What a differing field of a ledger's entry means; the order is that of cause and effect."""


@dataclass(frozen=True)
class Divergence:
    """The first difference between two ledgers.

    Args:
        line: of the ledger, from 1.
        frame: number of the frame in its log, as far as the first ledger tells.
        step: number of the step, likewise; None before the first.
        cause: input, schedule, random draw, loss, state or buffer.
        details: what differs, a line each, with the distance in ulp where it is a number.
    """

    line: int
    frame: int | None
    step: int | None
    cause: str
    details: list[str]


@dataclass(frozen=True)
class Comparison:
    """Two runs, compared.

    Args:
        origins: what of the manifests differs: log, configuration, versions, machine.
        divergence: the first difference of the ledgers; None where they are equal.
        tensors: each tensor of the final maps that differs, and by how much.
    """

    origins: list[str]
    divergence: Divergence | None
    tensors: dict[str, str]

    @property
    def is_same(self) -> bool:
        """Whether the two runs did the same, bit for bit."""
        return self.divergence is None and not self.tensors


def compare_runs(first: Path, second: Path) -> Comparison:
    """Compare two finished runs; raises a ProgroundError where one is none."""
    a, b = (RunFolder(path).require_finished() for path in (first, second))
    origins = _origins(Manifest.read(a.manifest), Manifest.read(b.manifest))
    return Comparison(origins, _first_divergence(a.ledger, b.ledger), _tensor_differences(a, b))


def _origins(a: Manifest, b: Manifest) -> list[str]:
    """Differences of what made the runs, a line each."""
    parts: list[str] = []
    first, second = dataclasses.asdict(a), dataclasses.asdict(b)
    for name in ("log_sha256", "config", "code_version", "packages", "machine"):
        parts += _differences(name, first[name], second[name])
    return parts


def _differences(name: str, first: object, second: object) -> list[str]:
    if isinstance(first, dict) and isinstance(second, dict):
        lines = []
        for key in [*first, *(k for k in second if k not in first)]:
            lines += _differences(f"{name}.{key}", first.get(key), second.get(key))
        return lines
    return [] if first == second else [f"{name}: {first} | {second}"]


def _first_divergence(first: Path, second: Path) -> Divergence | None:
    frame = step = None
    pairs = zip_longest(read_ledger(first), read_ledger(second))
    for line, (a, b) in enumerate(pairs, start=1):
        if a is None or b is None:
            longer, shorter = ("first", "second") if b is None else ("second", "first")
            details = [f"the {shorter} run ends here, the {longer} goes on"]
            return Divergence(line, frame, step, "schedule", details)
        frame, step = a.get("frame", frame), a.get("step", step)
        if a == b:
            continue
        fields = [name for name in CAUSES if a.get(name) != b.get(name)]
        details = [text for name in fields for text in _field_details(name, a, b)]
        return Divergence(line, frame, step, CAUSES[fields[0]], details)
    return None


def _field_details(name: str, a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    first, second = a.get(name), b.get(name)
    if name == "losses" and isinstance(first, dict) and isinstance(second, dict):
        lines = []
        for term in [*first, *(t for t in second if t not in first)]:
            if term not in first or term not in second:
                lines.append(f"loss {term}: only in one run")
            elif first[term] != second[term]:
                x, y = bits_float(first[term]), bits_float(second[term])
                ulp = ulp_distance(np.float32(x), np.float32(y))
                lines.append(f"loss {term}: {x:.9g} | {y:.9g} ({ulp} ulp)")
        return lines
    return _differences(name, first, second)


def ulp_distance(first: np.ndarray | np.float32, second: np.ndarray | np.float32) -> int:
    """Largest number of float32 values between corresponding elements."""
    distance = np.abs(_ordered(first) - _ordered(second))
    return int(distance.max(initial=0))


def _ordered(values: np.ndarray | np.float32) -> np.ndarray:
    """Whole numbers that count up with float32 values, int64."""
    bits = np.atleast_1d(values).astype(np.float32).view(np.int32).astype(np.int64)
    return np.where(bits < 0, -(bits & 0x7FFFFFFF), bits)


def _tensor_differences(a: RunFolder, b: RunFolder) -> dict[str, str]:
    first = dict(load_map(a.map).field.named_parameters())
    second = dict(load_map(b.map).field.named_parameters())
    differences = {}
    for name, tensor in first.items():
        x, y = tensor.detach().numpy(), second[name].detach().numpy()
        if x.shape != y.shape:
            differences[name] = f"shape {x.shape} | {y.shape}"
        elif distance := ulp_distance(x, y):
            differences[name] = f"{int((x != y).sum())} of {x.size} values, up to {distance} ulp"
    return differences
