"""Simulated time stands in the recording to the nanosecond, whatever the computer's trouble is."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rerun.components import AggregationPolicy, InterpolationMode

from proground_log.events import (
    Event,
    FrameArrived,
    FrameDropped,
    FrameScheduled,
    MeshExtracted,
    RegionsArrived,
    ViewRendered,
)
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from replay.scheduler import Policy
from tests.telemetry import telemetry_stream as stream
from tests.telemetry.telemetry_cells import Rows, cells_of, rows_of, scalars

FRAMES = 24
STAGES = ("decode", "perceive", "insert", "step")
LANES = (*STAGES, "idle")
POLICIES = {
    "unhurried": stream.UNHURRIED,
    "lock-step": replace(stream.UNHURRIED, lock_step=True),
    "hurried": replace(stream.UNHURRIED, budget_ns=180_000_000, queue=2, overrun="drop-oldest"),
    "newest": replace(stream.UNHURRIED, budget_ns=170_000_000, queue=3, overrun="drop-newest"),
    "overrun": replace(stream.UNHURRIED, budget_ns=20_000_000, perceive_every=3),
    "beside": replace(stream.UNHURRIED, budget_ns=120_000_000, overrun="drop-oldest", beside=True),
}
Span = tuple[int, int]


def events_of(policy: Policy) -> list[Event]:
    """A replay without pictures, which take the most time."""
    pictures = ViewRendered, MeshExtracted
    events = stream.of_frames(range(FRAMES), None, policy)
    return [event for event in events if not isinstance(event, pictures)]


def record(path: Path, events: list[Event], **resumed: Any) -> Path:
    """A segment of these events; `resumed` says what earlier ones hold."""
    sink = TelemetrySink(path, recording_id="run", **resumed)
    for event in events:
        sink.on_event(event)
    sink.close()
    return path


class Run:
    """A recorded schedule: what was told, and what the recording holds."""

    def __init__(self, path: Path, policy: Policy) -> None:
        self.path, self.policy = path, policy
        events = events_of(policy)
        self.slots = [event for event in events if isinstance(event, FrameScheduled)]
        self.drops = [event for event in events if isinstance(event, FrameDropped)]
        self.regions = [event for event in events if isinstance(event, RegionsArrived)]
        merge_segments([record(path, events)], path)
        self.rows: Rows = rows_of(path)

    def told(self, stage: str) -> list[Span]:
        """The spans of a stage, as the events give them."""
        spans = [slot.spans[stage] for slot in self.slots if stage in slot.spans]
        beside = self.regions if stage == "perceive" else []
        return sorted(spans + [(event.begin_ns, event.sim_time_ns) for event in beside])

    def drawn(self, stage: str) -> list[Span]:
        """The spans of a lane of the recording; checks that it goes up and down in turn."""
        if (f"/budget/lane/{stage}", "Scalars:scalars") not in self.rows:
            return []
        times, heights = scalars(self.rows, f"/budget/lane/{stage}")
        low = heights.min()
        edges = sorted(zip(times[:, 2].tolist(), (heights - low).tolist(), strict=True))
        begins = [time for time, height in edges if height == 1]
        ends = [time for time, height in edges if height == 0]
        assert len(begins) + len(ends) == len(edges)
        return list(zip(begins, ends, strict=True))

    def figure(self, name: str) -> list[float]:
        """A figure of each mapped frame; checks that it stands at the frame's end."""
        times, values = scalars(self.rows, f"/budget/{name}")
        assert times[:, 0].tolist() == [slot.frame_index for slot in self.slots]
        assert times[:, 2].tolist() == [slot.sim_time_ns for slot in self.slots]
        return values.tolist()


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    folder = tmp_path_factory.mktemp("runs")
    return {name: Run(folder / f"{name}.rrd", policy) for name, policy in POLICIES.items()}


@pytest.fixture(params=POLICIES)
def run(request: pytest.FixtureRequest, runs: dict[str, Run]) -> Run:
    return runs[request.param]


def test_every_span_is_there_to_the_nanosecond(run: Run) -> None:
    for stage in STAGES:
        assert run.drawn(stage) == run.told(stage)
    assert len(run.drawn("decode")) == len(run.slots)
    assert run.drawn("perceive")


def test_lanes_are_one_above_the_other(run: Run) -> None:
    tops = []
    for stage in LANES:
        if run.drawn(stage):
            heights = scalars(run.rows, f"/budget/lane/{stage}")[1]
            assert set(heights) == {heights.min(), heights.min() + 1}
            tops.append((heights.max(), heights.min()))
    assert all(below_top < low for (_, low), (below_top, _) in pairwise(tops))


def test_the_viewer_may_not_merge_or_slant_edges(run: Run) -> None:
    # With edges merged by pixel, a short pulse was seen to stay up until the next one.
    for stage in LANES:
        styles = {
            "aggregation_policy": AggregationPolicy.Off,
            "interpolation_mode": InterpolationMode.StepAfter,
        }
        for name, wanted in styles.items():
            [(times, value)] = run.rows[f"/budget/lane/{stage}", f"SeriesLines:{name}"]
            assert (times, value) == ((), [wanted.value])


def test_one_computer_does_one_thing_at_a_time_and_always_something(run: Run) -> None:
    stages = [stage for stage in LANES if not (run.policy.beside and stage == "perceive")]
    spans = sorted(span for stage in stages for span in run.drawn(stage))
    assert spans[0][0] == 0
    assert all(end == begin for (_, end), (begin, _) in pairwise(spans))
    assert spans[-1][1] == run.slots[-1].sim_time_ns


def test_perception_beside_runs_while_the_mapper_does(runs: dict[str, Run]) -> None:
    run = runs["beside"]
    assert len(run.regions) > 3
    steps = run.drawn("step")
    assert any(b < end and begin < e for b, e in run.drawn("perceive") for begin, end in steps)
    # It costs the mapper nothing.
    assert set(run.figure("spent_ms/perceive")) == {0}


def test_what_was_spent_is_what_the_lanes_show(run: Run) -> None:
    spent = {stage: run.figure(f"spent_ms/{stage}") for stage in STAGES}
    for number, slot in enumerate(run.slots):
        for stage in STAGES:
            begin_ns, end_ns = slot.spans.get(stage, (0, 0))
            assert spent[stage][number] == (end_ns - begin_ns) / 1e6
    mapper = [stage for stage in STAGES if not (run.policy.beside and stage == "perceive")]
    drawn_ns = sum(end - begin for stage in mapper for begin, end in run.drawn(stage))
    assert sum(map(sum, spent.values())) == pytest.approx(drawn_ns / 1e6, rel=1e-12)
    idle_ns = sum(end - begin for begin, end in run.drawn("idle"))
    assert sum(run.figure("idle_ms")) == pytest.approx(idle_ns / 1e6, rel=1e-12)


def test_the_figures_of_a_frame_are_those_told(run: Run) -> None:
    lags_ms = [(slot.sim_time_ns - slot.arrived_ns) / 1e6 for slot in run.slots]
    assert run.figure("lag_ms") == lags_ms
    assert run.figure("queue") == [slot.waiting for slot in run.slots]
    assert run.figure("steps") == [slot.steps for slot in run.slots]
    assert run.figure("overrun_ms") == [slot.overrun_ns / 1e6 for slot in run.slots]


def test_drops_are_counted_and_explained(run: Run) -> None:
    ends = [slot.sim_time_ns for slot in run.slots]
    assert run.figure("dropped") == [
        sum(drop.sim_time_ns <= end for drop in run.drops) for end in ends
    ]
    levels = [value[0] for _, value in run.rows["/log", "TextLog:level"]]
    said = zip(run.rows["/log", "TextLog:text"], levels, strict=True)
    warnings = [(times[0], times[2], text[0]) for (times, text), level in said if level == "WARN"]
    assert warnings == [
        (drop.frame_index, drop.sim_time_ns, f"frame {drop.frame_index} is dropped ({drop.reason})")
        for drop in run.drops
    ]


def test_the_policies_show_every_kind_of_trouble(runs: dict[str, Run]) -> None:
    assert all(runs[name].drops for name in ("hurried", "newest", "beside"))
    assert runs["unhurried"].drawn("idle")
    assert any(slot.overrun_ns and "step" not in slot.spans for slot in runs["overrun"].slots)
    assert max(runs["newest"].figure("queue")) == 2
    assert not runs["lock-step"].drawn("idle")


@pytest.mark.parametrize("name", ["newest", "beside"])
def test_segments_of_a_resumed_run_go_on_counting(
    tmp_path: Path, runs: dict[str, Run], name: str
) -> None:
    events = events_of(POLICIES[name])
    arrivals = [i for i, event in enumerate(events) if isinstance(event, FrameArrived)]
    cut = arrivals[len(arrivals) // 2]
    dropped = sum(isinstance(event, FrameDropped) for event in events[:cut])
    last = [event for event in events[:cut] if isinstance(event, FrameArrived)][-1]
    resumed = {
        "dropped_before": dropped,
        "steps_done": sum(e.steps for e in events[:cut] if isinstance(e, FrameScheduled)),
        "last_position_m": last.frame.world_from_camera[:3, 3],
    }
    first = record(tmp_path / "0.rrd", events[:cut])
    second = record(tmp_path / "1.rrd", [events[0], *events[cut:]], **resumed)
    merge_segments([first, second], tmp_path / "merged.rrd")
    assert cells_of(tmp_path / "merged.rrd") == cells_of(runs[name].path)
    assert 0 < dropped < len(runs[name].drops)
