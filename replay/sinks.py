"""Where the events of a replay go: ledger, telemetry, totals, watchers; and what a stage took."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict

import numpy as np

from proground_log.events import Event, Sink
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.ledger import LedgerSink
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from replay.tally import Tally

STAGES = ("decode", "perceive", "insert", "step", "views", "telemetry", "ledger")
"""What the machine's time is spent on; the first four are simulated too."""


class Sinks:
    """Everything that events are told to, in one order.

    Args:
        run: where ledger and telemetry go.
        checkpoint: what an interrupted replay had told up to there; None for a new one.
        recording_id: of the telemetry; None: there is none.
        watchers: further sinks.
    """

    def __init__(
        self,
        run: RunFolder,
        checkpoint: Checkpoint | None,
        recording_id: str | None,
        watchers: Sequence[Sink],
    ) -> None:
        self._run, self._watchers = run, watchers
        self.tally, self.seconds = Tally(), dict.fromkeys(STAGES, 0.0)
        if checkpoint is not None:
            self.tally = Tally(**checkpoint.simulation)
            self.seconds |= checkpoint.seconds
        self._ledger = LedgerSink(
            run.partial_ledger, 0 if checkpoint is None else checkpoint.ledger_lines
        )
        self._telemetry: TelemetrySink | None = None
        if recording_id is not None:
            self._telemetry = self._open_telemetry(recording_id, checkpoint)

    def _open_telemetry(self, recording_id: str, checkpoint: Checkpoint | None) -> TelemetrySink:
        """A new segment; what earlier ones say beyond the checkpoint will be said again."""
        segments = self._run.telemetry_segments()
        known = [] if checkpoint is None else checkpoint.telemetry_bytes
        for segment, length in zip(segments, [*known, *[0] * len(segments)], strict=False):
            with segment.open("r+b") as file:
                file.truncate(length)
        camera_m = [] if checkpoint is None else checkpoint.camera_m
        return TelemetrySink(
            self._run.next_telemetry_segment(),
            recording_id=recording_id,
            steps_done=0 if checkpoint is None else checkpoint.steps,
            last_position_m=np.array(camera_m) if camera_m else None,
            dropped_before=sum(self.tally.dropped.values()),
        )

    def emit(self, event: Event) -> None:
        """Tell an event to all."""
        self.tally.on_event(event)
        with self.timed("ledger"):
            self._ledger.on_event(event)
        if self._telemetry is not None:
            with self.timed("telemetry"):
                self._telemetry.on_event(event)
        for watcher in self._watchers:
            watcher.on_event(event)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the machine's time to a stage; it goes into the summary and nowhere else."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - start

    def flush(self) -> None:
        """Put all that was told so far on the disk."""
        self._ledger.flush()
        if self._telemetry is not None:
            self._telemetry.flush()

    def checkpoint(
        self, turns: int, steps: int, camera_m: list[float], state: dict[str, np.ndarray]
    ) -> Checkpoint:
        """What a resumed replay needs; ledger and telemetry are on the disk before it."""
        self.flush()
        segments = self._run.telemetry_segments() if self._telemetry is not None else []
        return Checkpoint(
            turns=turns,
            steps=steps,
            ledger_lines=self._ledger.lines,
            telemetry_bytes=[segment.stat().st_size for segment in segments],
            camera_m=camera_m,
            simulation=asdict(self.tally),
            seconds=self.seconds,
            state=state,
        )

    def finish(self) -> None:
        """Give ledger and telemetry their final names; all sinks are closed."""
        if self._telemetry is not None:
            merge_segments(self._run.telemetry_segments(), self._run.telemetry)
        self._run.partial_ledger.replace(self._run.ledger)

    def __enter__(self) -> Sinks:
        return self

    def __exit__(self, *_: object) -> None:
        """Close every sink, whatever happened to the others."""
        closing: list[Callable[[], None]] = [self._ledger.close]
        if self._telemetry is not None:
            closing.append(self._telemetry.close)
        closing += [watcher.close for watcher in self._watchers]
        with ExitStack() as stack:
            for close in closing:
                stack.callback(close)
