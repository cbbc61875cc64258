"""Scalars gathered over many steps and sent as columns: a hundredth of the cost of one by one."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import rerun as rr

ROWS_PER_CHUNK = 512
"""Rows gathered before they are sent: small chunks cost more in their headers than in data."""


@dataclass(frozen=True)
class Moment:
    """A point on the three timelines.

    Args:
        frame: number of the newest frame in its log.
        step: number of the newest optimisation step in the whole replay, 0 before the first.
        sim_time_ns: simulated time since the start of the replay.
    """

    frame: int
    step: int
    sim_time_ns: int

    def log(self, recording: rr.RecordingStream, entity: str, what: rr.AsComponents) -> None:
        """Log something at this point."""
        recording.set_time("frame", sequence=self.frame)
        recording.set_time("step", sequence=self.step)
        recording.set_time("sim_time", duration=np.timedelta64(self.sim_time_ns, "ns"))
        recording.log(entity, what)


class ScalarColumns:
    """Gathers scalars by entity and sends them in chunks.

    Args:
        recording: where they go.
    """

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._rows: defaultdict[str, list[tuple[Moment, tuple[float, ...]]]] = defaultdict(list)

    def add(self, entity: str, moment: Moment, *values: float) -> None:
        """Keep a row; send the entity's rows once there are enough of them.

        An entity with several values, always the same number, is that many curves.
        """
        rows = self._rows[entity]
        rows.append((moment, values))
        if len(rows) >= ROWS_PER_CHUNK:
            self._send(entity)

    def send(self) -> None:
        """Send all that is gathered."""
        for entity in list(self._rows):
            self._send(entity)

    def _send(self, entity: str) -> None:
        rows = self._rows.pop(entity)
        sim_time_ns = np.array([moment.sim_time_ns for moment, _ in rows], dtype=np.int64)
        times = [
            rr.TimeColumn("frame", sequence=[moment.frame for moment, _ in rows]),
            rr.TimeColumn("step", sequence=[moment.step for moment, _ in rows]),
            rr.TimeColumn("sim_time", duration=sim_time_ns.astype("timedelta64[ns]")),
        ]
        values = np.array([values for _, values in rows], dtype=np.float64)
        columns = rr.Scalars.columns(scalars=values.reshape(-1))
        lengths = np.full(len(rows), values.shape[1])
        self._recording.send_columns(entity, times, columns.partition(lengths))
