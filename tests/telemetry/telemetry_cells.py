"""What a recording holds, cell by cell: independent of batching, row ids and order."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

TIMELINES = ("frame", "step", "sim_time")
Rows = dict[tuple[str, str], list[tuple[tuple[int, ...], Any]]]


def rows_of(path: Path) -> Rows:
    """The values by (entity, component): (times on the timelines, or nothing; value), by time."""
    rows: Rows = {}
    for chunk in RrdReader(path).stream():
        batch = pa.record_batch(chunk.to_record_batch())
        assert set(chunk.timeline_names) in (set(), set(TIMELINES))
        times = [batch.column(name).cast(pa.int64()).to_pylist() for name in chunk.timeline_names]
        order = sorted(range(len(times)), key=lambda i: TIMELINES.index(chunk.timeline_names[i]))
        for name in batch.schema.names:
            if name.endswith("RowId") or name in TIMELINES:
                continue
            held = rows.setdefault((str(chunk.entity_path), name), [])
            for row, value in enumerate(batch.column(name).to_pylist()):
                if value is not None:
                    held.append((tuple(times[i][row] for i in order), value))
    for held in rows.values():
        held.sort(key=lambda cell: cell[0])
    return rows


def cells_of(path: Path) -> Counter[str]:
    """Every cell, as often as it is there; static ones once, since they replace each other."""
    cells: Counter[str] = Counter()
    for key, held in rows_of(path).items():
        for times, value in held:
            cell = repr((key, times, value))
            cells[cell] = cells[cell] + 1 if times else 1
    return cells


def scalars(rows: Rows, entity: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [N, 3] and values [N] of a curve."""
    held = rows[entity, "Scalars:scalars"]
    return np.array([t for t, _ in held]), np.array([value[0] for _, value in held])
