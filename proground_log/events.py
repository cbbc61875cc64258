"""Everything that happens in a replay, as frozen records.

The ledger, the rerun recording and the progress bar are sinks of this one stream, so they cannot
disagree. Arrays in an event are never written to after it was sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from proground_log.frame import Frame

Counts = Mapping[str, Mapping[str, Any] | None]
"""What a mapper holds, group by group: figures by name, which are whole numbers, lists of them, or
numbers by name; None for a group that stays empty."""


@dataclass(frozen=True)
class TaskKnown:
    """What meaning is learnt for.

    Args:
        name: the task's name.
        prompts: what labels are numbers of.
        colors: uint8 [K, 3] RGB, the prompts' colours.
    """

    name: str
    prompts: tuple[str, ...]
    colors: np.ndarray


@dataclass(frozen=True)
class MapperKnown:
    """What makes the map; told first, and again when a replay is resumed.

    Args:
        kind: its kind.
        has_steps: whether it does optimisation steps, so that there are losses.
        counts: what it holds before the first frame; so one knows what it counts.
        task: what meaning is learnt for; None where none is learnt.
    """

    kind: str
    has_steps: bool
    counts: Counts
    task: TaskKnown | None


@dataclass(frozen=True)
class FrameArrived:
    """A frame was read from the log and registered.

    Args:
        frame: the frame.
        sim_time_ns: simulated time since the start of the replay.
        input_digest: sha256 over what the mapper gets to see, hexadecimal.
        held_out: kept from the mapper, for evaluation.
    """

    frame: Frame
    sim_time_ns: int
    input_digest: str
    held_out: bool


@dataclass(frozen=True)
class FrameDropped:
    """A frame came while the mapper was busy, and never reached it.

    Args:
        frame_index: number of the frame in its log.
        sim_time_ns: when that was.
        reason: which rule it fell to.
    """

    frame_index: int
    sim_time_ns: int
    reason: str


@dataclass(frozen=True)
class RegionsArrived:
    """Perception beside the mapper has finished a frame that was mapped before.

    Args:
        frame_index: number of the frame in its log.
        begin_ns: simulated time at which perception began.
        sim_time_ns: when its regions reached the mapper.
    """

    frame_index: int
    begin_ns: int
    sim_time_ns: int


@dataclass(frozen=True)
class FrameScheduled:
    """What a mapped frame took, in simulated time since the start of the replay.

    Args:
        frame_index: number of the frame in its log.
        sim_time_ns: when the mapper was done with it.
        arrived_ns: when it arrived; the lag is the time from then.
        idle_ns: how long the mapper had nothing to do before it.
        waiting: frames that waited when it was taken, itself not counted.
        steps: optimisation steps that it was given.
        overrun_ns: what reading, perceiving and inserting it took beyond the budget.
        spans: begin and end of each stage that took place, by its name: decode, perceive, insert,
            step (all of them).
    """

    frame_index: int
    sim_time_ns: int
    arrived_ns: int
    idle_ns: int
    waiting: int
    steps: int
    overrun_ns: int
    spans: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class KeyframeInserted:
    """The frame's samples went into the replay buffer.

    Args:
        frame_index: number of the frame in its log.
        inserted: samples added.
        evicted: samples, old or new, that had to go to stay under the cap.
    """

    frame_index: int
    inserted: int
    evicted: int


@dataclass(frozen=True)
class StepDone:
    """One optimisation step.

    Args:
        frame_index: number of the newest frame.
        step: number of the step in the whole replay, from 0.
        iteration: number of the step in this frame, from 0.
        sim_time_ns: simulated time since the start of the replay.
        losses: each term by name, unweighted, and "total", the weighted sum; float32 values.
        draws_digest: sha256 over the rays and sample positions drawn, hexadecimal.
    """

    frame_index: int
    step: int
    iteration: int
    sim_time_ns: int
    losses: dict[str, float]
    draws_digest: str


@dataclass(frozen=True)
class SemanticScores:
    """How well the heads give back the regions of the log, in percent; nan where there is none.

    Args:
        frame_index: number of the newest frame.
        label: semantic head: rays whose best prompt is their region's.
        scale: scale head: rays of regions whose level is right.
        background: scale head: rays of no region that are told as such.
        uncertainty: uncertainty head: rays told rightly with or without supervision.
    """

    frame_index: int
    label: float
    scale: float
    background: float
    uncertainty: float


@dataclass(frozen=True)
class FrameDone:
    """All steps of a frame are done.

    Args:
        frame_index: number of the frame in its log.
        steps: steps done for it.
        sim_time_ns: simulated time since the start of the replay.
        counts: what the mapper holds afterwards.
    """

    frame_index: int
    steps: int
    sim_time_ns: int
    counts: Counts


@dataclass(frozen=True)
class StateDigested:
    """Fingerprints of the mapper's whole state after a step.

    Args:
        step: number of steps done.
        digests: sha256 by tensor name ("field/...", "optimiser/...", "buffer/..."), hexadecimal.
    """

    step: int
    digests: dict[str, str]


@dataclass(frozen=True)
class SemanticView:
    """What a rendered view means.

    Args:
        labels, observed_labels: int16 [h, w], number of the best prompt in the map and in the
            frame's regions; -1 for background and where there is no surface.
        features: uint8 [h, w, 3], the embeddings' colours, black where there is no surface.
        levels: uint8 [h, w], pyramid level 0 to 2, or 3 for "no supervision".
        uncertainty: float32 [h, w] in [0, 1].

    The last three are None where the map does not have them.
    """

    labels: np.ndarray
    observed_labels: np.ndarray
    features: np.ndarray | None
    levels: np.ndarray | None
    uncertainty: np.ndarray | None


@dataclass(frozen=True)
class ViewRendered:
    """The map seen from a frame's camera, beside what the sensor saw.

    Args:
        frame_index: number of the frame in its log.
        color, rendered_color: uint8 [h, w, 3] RGB, black where the sensor saw nothing.
        depth_m, rendered_depth_m: float32 [h, w] metres, 0 where there is nothing.
        semantics: what it means; None where no meaning is learnt.
    """

    frame_index: int
    color: np.ndarray
    depth_m: np.ndarray
    rendered_color: np.ndarray
    rendered_depth_m: np.ndarray
    semantics: SemanticView | None = None


@dataclass(frozen=True)
class SurfaceMeaning:
    """What the surface means at each vertex.

    Args:
        labels: int16 [V], number of the best prompt; -1 for background.
        features: uint8 [V, 3], the embeddings' colours; None where the map keeps none.
        relevance: float32 [V] in [0, 1], to one prompt.
        prompt: that prompt.
    """

    labels: np.ndarray
    features: np.ndarray | None
    relevance: np.ndarray
    prompt: str


@dataclass(frozen=True)
class MeshExtracted:
    """The surface of the map so far.

    Args:
        frame_index: number of the newest frame.
        vertices_m: float32 [V, 3], world axes.
        faces: int32 [F, 3], counter-clockwise seen from outside.
        normals: float32 [V, 3], towards free space.
        colors: uint8 [V, 3] RGB.
        meaning: what it means; None where no meaning is learnt.
    """

    frame_index: int
    vertices_m: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    meaning: SurfaceMeaning | None = None


@dataclass(frozen=True)
class RunFinished:
    """The replay is complete.

    Args:
        summary: figures by name, as in the summary table; JSON values.
    """

    summary: dict[str, object]


Event = (
    MapperKnown
    | FrameArrived
    | FrameDropped
    | RegionsArrived
    | KeyframeInserted
    | StepDone
    | FrameScheduled
    | FrameDone
    | SemanticScores
    | StateDigested
    | ViewRendered
    | MeshExtracted
    | RunFinished
)


class Sink(Protocol):
    """Something that events are told to, in order."""

    def on_event(self, event: Event) -> None: ...

    def close(self) -> None:
        """Flush what is pending; called once, after the last event or an interruption."""
        ...
