"""A short event stream: a camera that circles a sphere, with all that a replay tells of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import pairwise

import cv2
import numpy as np
import trimesh

from proground_log.camera import Camera
from proground_log.events import (
    Counts,
    Event,
    FrameArrived,
    FrameDone,
    FrameDropped,
    FrameScheduled,
    KeyframeInserted,
    MapperKnown,
    MeshExtracted,
    RegionsArrived,
    RunFinished,
    SemanticScores,
    SemanticView,
    StateDigested,
    StepDone,
    SurfaceMeaning,
    TaskKnown,
    ViewRendered,
)
from proground_log.frame import Frame
from proground_log.mapping.neural.statistics import BufferStatistics, SemanticStatistics
from replay.scheduler import Drop, Policy, Slot, Timing, schedule

CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
STEPS_PER_FRAME = 3
FRAME_NS = 100_000_001
TIMING = Timing(decode_ns=3_000_001, perceive_ns=41_000_003, insert_ns=2_000_007, step_ns=7_000_003)
INGEST_NS = TIMING.decode_ns + TIMING.insert_ns
UNHURRIED = Policy(
    budget_ns=None,
    steps=STEPS_PER_FRAME,
    lock_step=False,
    queue=1,
    overrun="wait",
    perceive_every=2,
)
"""Every frame is mapped as soon as it arrives, and there is time to spare."""
CAPACITY = 100
TASK = TaskKnown(
    "breakfast",
    ("a red chair", "salt/pepper | mill", "mug"),
    np.array([[230, 60, 50], [60, 200, 90], [70, 120, 250]], dtype=np.uint8),
)


def position_m(index: int) -> np.ndarray:
    """Where the camera is at a frame, [3]."""
    return np.array([np.cos(index / 5), np.sin(index / 5), 0.1 * index])


def losses(step: int, task: TaskKnown | None = None) -> dict[str, float]:
    """The loss terms of a step: float32 values, as the mapper gives them."""
    rng = np.random.default_rng(step)
    names = ["color", "depth", "sdf", "total"]
    if task is not None:
        # At first no region is known, as in a replay.
        names[3:3] = ["semantic", "scale", "uncertainty"] if step else ["scale", "uncertainty"]
    return {name: float(np.float32(rng.random())) for name in names}


def statistics(index: int, task: TaskKnown) -> SemanticStatistics:
    """The memory of meaning, in which each label has its share."""
    labels = {prompt: (number + 1) * index for number, prompt in enumerate(task.prompts)}
    total = sum(labels.values())
    return SemanticStatistics(
        total, 1000, 7 * index, 3 + index, labels, [total, index, 2], 2 * total, total, 4 * total
    )


def counts(index: int, held: int, task: TaskKnown | None) -> Counts:
    """What is held after a frame."""
    buffer = BufferStatistics(held, CAPACITY, index + 1, 5 + index, 7, 40 * held)
    memory = None if task is None else asdict(statistics(index, task))
    return {"buffer": asdict(buffer), "semantics": memory}


def scores(index: int) -> SemanticScores:
    """Scores that rise; there is no background to judge by in odd frames."""
    percent = 50.0 + 7.3 * index
    background = float("nan") if index % 2 else percent / 3
    return SemanticScores(index, percent, percent / 2, background, 100.0 - percent)


def semantic_view(index: int, task: TaskKnown) -> SemanticView:
    """Stripes of all labels and of background, shifted by a pixel between map and frame."""
    rows, columns = np.mgrid[:24, :32]
    stripes = (columns + index) // 4 % (len(task.prompts) + 1) - 1
    return SemanticView(
        labels=stripes.astype(np.int16),
        observed_labels=np.roll(stripes, 1, axis=1).astype(np.int16),
        features=np.stack([8 * columns, 10 * rows, 255 - 8 * columns], axis=2).astype(np.uint8),
        levels=(rows // 6 % 4).astype(np.uint8),
        uncertainty=((rows + columns) / 54).astype(np.float32),
    )


def meaning(vertices_m: np.ndarray, task: TaskKnown) -> SurfaceMeaning:
    """Labels along one axis, relevance along another."""
    rank = (vertices_m - vertices_m.min(axis=0)) / np.ptp(vertices_m, axis=0)
    return SurfaceMeaning(
        labels=np.floor(rank[:, 1] * (len(task.prompts) + 0.99) - 1).astype(np.int16),
        features=np.rint(255 * rank).astype(np.uint8),
        relevance=rank[:, 0].astype(np.float32),
        prompt=task.prompts[1],
    )


def mesh(index: int, task: TaskKnown | None = None) -> MeshExtracted:
    """A sphere that grows with the frames."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3 + 0.05 * index)
    vertices = np.asarray(ball.vertices, dtype=np.float32)
    return MeshExtracted(
        frame_index=index,
        vertices_m=vertices,
        faces=np.asarray(ball.faces, dtype=np.int32),
        normals=np.asarray(ball.vertex_normals, dtype=np.float32),
        colors=(255 * np.clip(vertices + 0.5, 0, 1)).astype(np.uint8),
        meaning=meaning(vertices, task) if task is not None else None,
    )


def view(index: int, task: TaskKnown | None = None) -> ViewRendered:
    """A view whose render is the blurred input."""
    rng = np.random.default_rng(index)
    color = cv2.resize(rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), (32, 24))
    depth_m = cv2.resize(rng.uniform(1, 4, (6, 8)).astype(np.float32), (32, 24))
    depth_m[:4] = 0.0
    rendered_m = np.asarray(depth_m + np.float32(0.05), dtype=np.float32)
    return ViewRendered(
        index,
        color,
        depth_m,
        cv2.GaussianBlur(color, (0, 0), 1.5),
        rendered_m,
        semantic_view(index, task) if task is not None else None,
    )


def mapper_known(task: TaskKnown | None) -> MapperKnown:
    """What the field's mapper says of itself at first."""
    return MapperKnown("neural", True, counts(0, 0, task), task)


def of_frames(
    indices: range, task: TaskKnown | None = None, policy: Policy = UNHURRIED
) -> Iterator[Event]:
    """All events of some frames of a replay from 0; with a task, those of meaning too.

    Args:
        indices: the frames that are mapped or dropped here.
        task: told at first; None where there is none.
        policy: what is done with frames that arrive too fast.
    """
    yield mapper_known(task)
    step = free_ns = 0
    for slot in slots(indices.stop, policy):
        if slot.frame in indices:
            idle_ns = max(0, slot.begin_ns - free_ns)
            yield from of_slot(slot, step, idle_ns, task, beside=policy.beside)
        step += slot.steps
        free_ns = slot.end_ns


def slots(frames: int, policy: Policy) -> Iterator[Slot]:
    """What the mapped ones of so many frames get."""
    arrivals_ns = [index * FRAME_NS for index in range(frames)]
    return schedule(range(frames), arrivals_ns, TIMING, policy)


def of_slot(
    slot: Slot, first_step: int, idle_ns: int, task: TaskKnown | None, *, beside: bool
) -> Iterator[Event]:
    """All events of a mapped frame, and of what else happened meanwhile."""
    index = slot.frame
    world_from_camera = np.eye(4)
    world_from_camera[:3, 3] = position_m(index)
    frame = Frame(
        index=index,
        stamp_ns=index * FRAME_NS,
        camera=CAMERA,
        world_from_camera=world_from_camera,
        depth_m=np.full((48, 64), 2.0, dtype=np.float32),
        color=np.full((48, 64, 3), (20 * index + 10) % 256, dtype=np.uint8),
        color_valid=np.ones((48, 64), dtype=bool),
        labels=None,
    )
    yield FrameArrived(frame, slot.begin_ns, f"{index:064x}", index % 4 == 3)
    held = min(CAPACITY, 30 * (index + 1))
    yield KeyframeInserted(index, 30, 30 * (index + 1) - held)
    steps_ns = slot.end_ns - slot.steps * TIMING.step_ns
    for iteration in range(slot.steps):
        step = first_step + iteration
        now_ns = steps_ns + TIMING.step_ns * (iteration + 1)
        yield StepDone(index, step, iteration, now_ns, losses(step, task), "0" * 64)
    for happening in slot.meanwhile:
        if isinstance(happening, Drop):
            yield FrameDropped(happening.frame, happening.at_ns, happening.reason)
        else:
            yield RegionsArrived(happening.frame, happening.begin_ns, happening.at_ns)
    yield FrameScheduled(
        frame_index=index,
        sim_time_ns=slot.end_ns,
        arrived_ns=slot.arrived_ns,
        idle_ns=idle_ns,
        waiting=slot.waiting,
        steps=slot.steps,
        overrun_ns=slot.overrun_ns,
        spans=spans(slot, beside=beside),
    )
    yield FrameDone(index, slot.steps, slot.end_ns, counts(index, held, task))
    if task is not None:
        yield scores(index)
    yield view(index, task)
    yield mesh(index, task)
    yield StateDigested(first_step + slot.steps, {"field/grid": f"{index:064x}"})


def spans(slot: Slot, *, beside: bool) -> dict[str, tuple[int, int]]:
    """Begin and end of the stages that a slot has."""
    lengths = {
        "decode": TIMING.decode_ns,
        "perceive": TIMING.perceive_ns if slot.is_perceived and not beside else 0,
        "insert": TIMING.insert_ns,
        "step": slot.steps * TIMING.step_ns,
    }
    ends = np.cumsum([slot.begin_ns, *lengths.values()]).tolist()
    pairs = zip(lengths, pairwise(ends), strict=True)
    return {stage: (begin, end) for stage, (begin, end) in pairs if end > begin}


FINISHED = RunFinished({"frames": 6, "psnr_db": 24.25, "stages": {"step_s": 1.5}})
