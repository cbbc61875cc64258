"""The totals of simulated time: what became of the frames, and where the time went."""

from __future__ import annotations

import resource
import sys
from dataclasses import dataclass, field

from proground_log.events import Counts, Event, FrameDropped, FrameScheduled, RegionsArrived
from proground_log.mapping.mapper import Mapper

NS_PER_S = 1_000_000_000


@dataclass
class Tally:
    """Adds up the schedule, event by event; a checkpoint keeps it as a dict.

    Args:
        mapped: frames mapped.
        steps: steps given to them.
        dropped: frames dropped, by reason.
        perceived_beside: frames whose regions came from beside the mapper.
        stages_ns: time by stage.
        idle_ns: time without anything to do.
        end_ns: end of the last frame.
        overruns: frames whose reading, perceiving and inserting took more than the budget.
        lag_ns, worst_lag_ns: time from the arrival of a frame to the end of its turn, in all and
            at most.
        longest_queue: most frames that waited.
    """

    mapped: int = 0
    steps: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    perceived_beside: int = 0
    stages_ns: dict[str, int] = field(default_factory=dict)
    idle_ns: int = 0
    end_ns: int = 0
    overruns: int = 0
    lag_ns: int = 0
    worst_lag_ns: int = 0
    longest_queue: int = 0

    def on_event(self, event: Event) -> None:
        """Add an event."""
        match event:
            case FrameDropped():
                self.dropped[event.reason] = self.dropped.get(event.reason, 0) + 1
            case RegionsArrived():
                self.perceived_beside += 1
            case FrameScheduled():
                self._on_scheduled(event)

    def _on_scheduled(self, event: FrameScheduled) -> None:
        self.mapped += 1
        self.steps += event.steps
        for stage, (begin_ns, end_ns) in event.spans.items():
            self.stages_ns[stage] = self.stages_ns.get(stage, 0) + end_ns - begin_ns
        self.idle_ns += event.idle_ns
        self.end_ns = event.sim_time_ns
        self.overruns += event.overrun_ns > 0
        lag_ns = event.sim_time_ns - event.arrived_ns
        self.lag_ns += lag_ns
        self.worst_lag_ns = max(self.worst_lag_ns, lag_ns)
        self.longest_queue = max(self.longest_queue, event.waiting)

    def summary(self, *, has_steps: bool) -> dict[str, object]:
        """The report, in seconds; JSON values. Steps are in it where the mapper does any."""
        return {
            "frames mapped": self.mapped,
            "frames dropped": sum(self.dropped.values()),
            **{f"dropped, {reason}": count for reason, count in self.dropped.items()},
            **({"perceived beside": self.perceived_beside} if self.perceived_beside else {}),
            **({"steps": self.steps} if has_steps else {}),
            "overruns": self.overruns,
            "longest queue": self.longest_queue,
            "mean lag s": round(self.lag_ns / NS_PER_S / max(self.mapped, 1), 4),
            "worst lag s": round(self.worst_lag_ns / NS_PER_S, 4),
            "elapsed s": round(self.end_ns / NS_PER_S, 3),
            "idle s": round(self.idle_ns / NS_PER_S, 3),
            **{f"{stage} s": round(ns / NS_PER_S, 3) for stage, ns in self.stages_ns.items()},
        }


def summary_of(
    turns: int, steps: int | None, mapper: Mapper, tally: Tally, seconds: dict[str, float]
) -> dict[str, object]:
    """What a run came to: the figures of its manifest, its table and its telemetry; JSON values.

    Args:
        turns: frames read, mapped or held out.
        steps: optimisation steps done; None: the mapper does none.
        mapper: at its end.
        tally: of simulated time.
        seconds: the machine's time by stage.
    """
    dropped = sum(tally.dropped.values())
    task = {} if mapper.description is None else {"task": mapper.description.task.name}
    return {
        "frames arrived": turns + dropped,
        "frames mapped": tally.mapped,
        "frames dropped": dropped,
        "frames held out": turns - tally.mapped,
        **({} if steps is None else {"steps": steps}),
        **task,
        **_figures(mapper.counts()),
        "map MB": round(sum(mapper.map().sizes_bytes().values()) / 1e6, 2),
        "peak memory MB": round(peak_memory_bytes() / 1e6),
        "simulation": tally.summary(has_steps=steps is not None),
        "machine s": {stage: round(s, 3) for stage, s in seconds.items()},
    }


def _figures(counts: Counts) -> dict[str, object]:
    """What a mapper holds, each figure by its group and name; memory in megabytes."""
    figures: dict[str, object] = {}
    for group, held in counts.items():
        for name, value in (held or {}).items():
            title = f"{group} {name.replace('_', ' ')}"
            if name == "size_bytes":
                figures[f"{group} MB"] = round(value / 1e6, 2)
            elif isinstance(value, int):
                figures[title] = value
    return figures


def peak_memory_bytes() -> int:
    """Most memory this process ever had resident."""
    # Linux counts kibibytes, macOS bytes.
    unit_bytes = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit_bytes
