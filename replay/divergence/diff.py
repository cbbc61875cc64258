"""Where two runs part ways, and what made them differ; runs of different versions as well."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from replay.divergence.distance import TensorDifference, tensor_differences
from replay.divergence.divergence import ABSENT, Divergence, first_divergence
from replay.divergence.table import DifferenceRow, difference_table

NO_ORIGIN = ("log_path", "threads", "result")
"""Parts of a manifest that reach no result."""


@dataclass(frozen=True)
class Comparison:
    """Two runs, compared.

    Args:
        origins: what of the manifests differs: log, settings, cost model, versions, machine.
        divergence: the first difference of the ledgers; None where they are equal.
        passed_over: what only one of the ledgers has up to there, as its version writes it.
        tensors: each tensor of the final maps that differs, and by how much.
    """

    origins: list[str]
    divergence: Divergence | None
    passed_over: list[str]
    tensors: dict[str, TensorDifference]

    @property
    def is_same(self) -> bool:
        """Whether the two runs did the same, bit for bit."""
        return self.divergence is None and not self.tensors


def compare_runs(first: Path, second: Path) -> Comparison:
    """Compare two finished runs.

    Raises:
        ProgroundError: one is no finished run, or the two have nothing in common.
    """
    a, b = (RunFolder(path).require_finished() for path in (first, second))
    origins = origins_of(a, b)
    divergence, passed_over = first_divergence(read_ledger(a.ledger), read_ledger(b.ledger))
    if divergence is not None:
        require_common(a, b)
    return Comparison(origins, divergence, passed_over, _map_differences(a, b))


def compare_all(first: Path, second: Path) -> list[DifferenceRow]:
    """All that differs between the ledgers of two comparable runs."""
    a, b = RunFolder(first), RunFolder(second)
    return difference_table(read_ledger(a.ledger), read_ledger(b.ledger))


def origins_of(a: RunFolder, b: RunFolder) -> list[str]:
    """Differences of what made two runs, a line each."""
    first, second = ({**_manifest(run)} for run in (a, b))
    for name in NO_ORIGIN:
        first.pop(name, None), second.pop(name, None)
    lines: list[str] = []
    for name in [*first, *(name for name in second if name not in first)]:
        lines += _differences(name, first.get(name, ABSENT), second.get(name, ABSENT))
    return lines


def _manifest(run: RunFolder) -> dict[str, Any]:
    """A manifest's content, whatever its version."""
    try:
        content = json.loads(require_file(run.manifest).read_text())
    except ValueError as error:
        content = error
    if not isinstance(content, dict):
        raise ProgroundError(
            f"cannot be read as a manifest ({content!r:.80})",
            where=run.manifest,
            todo="run the replay again",
        )
    return content


def _differences(name: str, first: object, second: object) -> list[str]:
    if isinstance(first, dict) and isinstance(second, dict):
        lines = []
        for key in [*first, *(k for k in second if k not in first)]:
            lines += _differences(f"{name}.{key}", first.get(key, ABSENT), second.get(key, ABSENT))
        return lines
    return [] if first == second else [f"{name}: {first} | {second}"]


def require_common(a: RunFolder, b: RunFolder) -> None:
    """Raise a ProgroundError where two runs saw no frame in common."""
    first, second = _inputs(a), _inputs(b)
    common = first.keys() & second.keys()
    where = f"{a.path} and {b.path}"
    if not common:
        raise ProgroundError(
            "no frame is in both runs", where=where, todo="compare runs of the same frames"
        )
    logs = [_manifest(run).get("log_sha256") for run in (a, b)]
    if logs[0] != logs[1] and all(first[frame] != second[frame] for frame in common):
        raise ProgroundError(
            f"the runs are of different logs: none of {len(common)} frames is the same in both",
            where=where,
            todo="compare runs of one log",
        )


def _inputs(run: RunFolder) -> dict[int, str | None]:
    """The fingerprint of each frame that arrived; None where the mapper never saw it."""
    arrivals = (e for e in read_ledger(run.ledger) if e["event"] in ("frame", "dropped"))
    return {entry["frame"]: entry.get("input") for entry in arrivals}


def _map_differences(a: RunFolder, b: RunFolder) -> dict[str, TensorDifference]:
    return tensor_differences(_map_tensors(a.map), _map_tensors(b.map))


def _map_tensors(path: Path) -> dict[str, np.ndarray]:
    """The tensors of a map as they are on disk, by name; those of the field by its own names."""
    try:
        with safe_open(require_file(path), framework="numpy") as file:
            names = sorted(file.keys())
            return {name.removeprefix("field/"): file.get_tensor(name) for name in names}
    except SafetensorError as error:
        raise ProgroundError(
            f"cannot be read as a map ({error})", where=path, todo="run the replay again"
        ) from error
