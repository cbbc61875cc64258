"""A short event stream: a camera that circles a sphere, with all that a replay tells of."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import trimesh

from proground_log.camera import Camera
from proground_log.events import (
    BufferStatistics,
    Event,
    FrameArrived,
    FrameDone,
    KeyframeInserted,
    MeshExtracted,
    RunFinished,
    StateDigested,
    StepDone,
    ViewRendered,
)
from proground_log.frame import Frame

CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
STEPS_PER_FRAME = 3
FRAME_NS = 100_000_001
CAPACITY = 100


def position_m(index: int) -> np.ndarray:
    """Where the camera is at a frame, [3]."""
    return np.array([np.cos(index / 5), np.sin(index / 5), 0.1 * index])


def losses(step: int) -> dict[str, float]:
    """The loss terms of a step: float32 values, as the mapper gives them."""
    rng = np.random.default_rng(step)
    return {name: float(np.float32(rng.random())) for name in ("color", "depth", "sdf", "total")}


def mesh(index: int) -> MeshExtracted:
    """A sphere that grows with the frames."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3 + 0.05 * index)
    vertices = np.asarray(ball.vertices, dtype=np.float32)
    return MeshExtracted(
        frame_index=index,
        vertices_m=vertices,
        faces=np.asarray(ball.faces, dtype=np.int32),
        normals=np.asarray(ball.vertex_normals, dtype=np.float32),
        colors=(255 * np.clip(vertices + 0.5, 0, 1)).astype(np.uint8),
    )


def view(index: int) -> ViewRendered:
    """A view whose render is the blurred input."""
    rng = np.random.default_rng(index)
    color = cv2.resize(rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), (32, 24))
    depth_m = cv2.resize(rng.uniform(1, 4, (6, 8)).astype(np.float32), (32, 24))
    depth_m[:4] = 0.0
    rendered_m = np.asarray(depth_m + np.float32(0.05), dtype=np.float32)
    return ViewRendered(index, color, depth_m, cv2.GaussianBlur(color, (0, 0), 1.5), rendered_m)


def of_frame(index: int) -> Iterator[Event]:
    """All events of one frame."""
    held_out = index % 4 == 3
    begin_ns = index * FRAME_NS
    world_from_camera = np.eye(4)
    world_from_camera[:3, 3] = position_m(index)
    frame = Frame(
        index=index,
        stamp_ns=begin_ns,
        camera=CAMERA,
        world_from_camera=world_from_camera,
        depth_m=np.full((48, 64), 2.0, dtype=np.float32),
        color=np.full((48, 64, 3), (20 * index + 10) % 256, dtype=np.uint8),
        color_valid=np.ones((48, 64), dtype=bool),
        labels=None,
    )
    yield FrameArrived(frame, begin_ns, f"{index:064x}", held_out)
    held = min(CAPACITY, 30 * (index + 1))
    yield KeyframeInserted(index, 30, 30 * (index + 1) - held)
    for iteration in range(STEPS_PER_FRAME):
        step = index * STEPS_PER_FRAME + iteration
        now_ns = begin_ns + 7_000_003 * (iteration + 1)
        yield StepDone(index, step, iteration, now_ns, losses(step), "0" * 64, 8, 8)
    yield view(index)
    yield mesh(index)
    buffer = BufferStatistics(held, CAPACITY, index + 1, 5 + index, 7, 40 * held)
    yield FrameDone(index, STEPS_PER_FRAME, begin_ns + 50_000_000, buffer)
    yield StateDigested((index + 1) * STEPS_PER_FRAME, {"field/grid": f"{index:064x}"})


def of_frames(indices: range) -> Iterator[Event]:
    """All events of some frames."""
    for index in indices:
        yield from of_frame(index)


FINISHED = RunFinished({"frames": 6, "psnr_db": 24.25, "stages": {"step_s": 1.5}})
