"""What a recording shows of simulated time: a lane for each stage, lag, queue and drops."""

from __future__ import annotations

import rerun as rr

from proground_log.events import Event, FrameDropped, FrameScheduled, RegionsArrived
from proground_log.palette import CURVE_COLORS, NOTHING_COLOR
from proground_log.telemetry.columns import Moment, ScalarColumns

STAGES = ("decode", "perceive", "insert", "step")
"""The stages that a frame's time is spent on, in their order."""
LANES = (*STAGES, "idle")
"""The lanes from top to bottom."""
LANE_COLORS = dict(zip(LANES, (*CURVE_COLORS[: len(STAGES)], NOTHING_COLOR), strict=True))
LANE_PITCH = 1.5
"""From lane to lane; the wave itself is 1 high."""
FIGURES = ("lag_ms", "idle_ms", "overrun_ms", "queue", "steps", "dropped")
NS_PER_MS = 1e6


class BudgetDrawing:
    """Draws the schedule: when each stage ran, and what became of the frames.

    A lane is a square wave, up from the begin of a span to its end; both stand at their own
    simulated times. The figures of a frame stand at its end, the drops up to then among them.

    Args:
        recording, scalars: where it goes.
        dropped_before: dropped frames that earlier segments tell of.
    """

    def __init__(
        self, recording: rr.RecordingStream, scalars: ScalarColumns, dropped_before: int
    ) -> None:
        self._recording, self._scalars = recording, scalars
        self._dropped = dropped_before
        self._introduce()

    def on_event(self, event: Event, now: Moment) -> None:
        """Draw what an event says of simulated time."""
        match event:
            case FrameDropped():
                self._on_dropped(event, now)
            case RegionsArrived():
                spans = {"perceive": (event.begin_ns, event.sim_time_ns)}
                self._draw_lanes(spans, event.frame_index, now.step)
            case FrameScheduled():
                self._on_scheduled(event, now)

    def _introduce(self) -> None:
        """All that stands for the whole recording: names and colours."""
        for stage, color in LANE_COLORS.items():
            lane = rr.SeriesLines(
                colors=color,
                widths=1.5,
                names=stage,
                interpolation_mode="StepAfter",
                # Any other would put up and down out of order where they share a pixel.
                aggregation_policy="Off",
            )
            self._log_static(f"lane/{stage}", lane)
        for stage in STAGES:
            self._introduce_figure(f"spent_ms/{stage}", f"{stage} (ms)", LANE_COLORS[stage])
        for name, color in zip(FIGURES, CURVE_COLORS, strict=False):
            self._introduce_figure(name, name.replace("_ms", " (ms)"), color)

    def _introduce_figure(self, name: str, title: str, color: tuple[int, int, int]) -> None:
        line = rr.SeriesLines(
            colors=color,
            widths=1.5,
            names=title,
            # A count holds from then on; the others tell of the time up to where they stand.
            interpolation_mode="StepAfter" if name == "dropped" else "StepBefore",
        )
        self._log_static(name, line)

    def _on_dropped(self, event: FrameDropped, now: Moment) -> None:
        self._dropped += 1
        moment = Moment(event.frame_index, now.step, event.sim_time_ns)
        text = f"frame {event.frame_index} is dropped ({event.reason})"
        moment.log(self._recording, "log", rr.TextLog(text, level="WARN"))

    def _on_scheduled(self, event: FrameScheduled, now: Moment) -> None:
        begin_ns = min((begin for begin, _ in event.spans.values()), default=event.sim_time_ns)
        idle = {"idle": (begin_ns - event.idle_ns, begin_ns)} if event.idle_ns else {}
        self._draw_lanes(event.spans | idle, event.frame_index, now.step)
        figures = {
            "lag_ms": (event.sim_time_ns - event.arrived_ns) / NS_PER_MS,
            "idle_ms": event.idle_ns / NS_PER_MS,
            "overrun_ms": event.overrun_ns / NS_PER_MS,
            "queue": event.waiting,
            "steps": event.steps,
            "dropped": self._dropped,
        }
        for stage in STAGES:
            begin_ns, end_ns = event.spans.get(stage, (0, 0))
            figures[f"spent_ms/{stage}"] = (end_ns - begin_ns) / NS_PER_MS
        moment = Moment(event.frame_index, now.step, event.sim_time_ns)
        for name, value in figures.items():
            self._scalars.add(f"budget/{name}", moment, value)

    def _draw_lanes(self, spans: dict[str, tuple[int, int]], frame: int, step: int) -> None:
        for stage, (begin_ns, end_ns) in spans.items():
            entity, low = f"budget/lane/{stage}", _lane_height(stage)
            self._scalars.add(entity, Moment(frame, step, begin_ns), low + 1)
            self._scalars.add(entity, Moment(frame, step, end_ns), low)

    def _log_static(self, name: str, what: rr.AsComponents) -> None:
        self._recording.log(f"budget/{name}", what, static=True)


def _lane_height(stage: str) -> float:
    """Where a stage's lane is at rest."""
    return LANE_PITCH * (len(LANES) - 1 - LANES.index(stage))
