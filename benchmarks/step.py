"""One mapping step against the same step with the plain-torch grid, and against its decoders."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import torch

from benchmarks.rows import Row, median_seconds
from proground_log.bounds import Bounds
from proground_log.field.encodings import hash_grid_torch
from proground_log.log.registration import Registration
from proground_log.mapping.neural.config import NeuralConfig, SamplingConfig
from proground_log.mapping.neural.online_mapper import OnlineMapper
from recorders.room import RoomSource
from replay.device import choose_device

FRAMES = 8
STEPS_BEFORE = 3
PUBLISHED = SamplingConfig(rays=1024, uniform=32, near_surface=11)
BOUNDS = Bounds((-0.3, -0.3, -0.3), (6.3, 5.3, 3.0))


def mapper_in_the_room() -> OnlineMapper:
    """A mapper that has seen a few frames of the built-in room, at the published sampling."""
    source = RoomSource(frames=FRAMES)
    register = Registration(source.calibration)
    mapper = OnlineMapper(replace(NeuralConfig(), sampling=PUBLISHED), BOUNDS, 0, "cpu")
    for index in range(FRAMES):
        mapper.insert(register(source.frame(index)))
        for _ in range(STEPS_BEFORE):
            mapper.step()
    return mapper


def measure() -> list[Row]:
    """Times and ratios of a step of 1024 rays x 43 samples."""
    choose_device("cpu")  # as a replay does: torch computes deterministically
    ours, plain = mapper_in_the_room(), mapper_in_the_room()
    field = plain.field
    field.hash_features = partial(  # type: ignore[method-assign]
        hash_grid_torch, table=field.table, layout=field.layout
    )
    points = PUBLISHED.rays * (PUBLISHED.uniform + PUBLISHED.near_surface)
    hashed = torch.rand(points, 32).requires_grad_()
    blob = torch.rand(points, 48)
    upstream_sdf, upstream_color = torch.rand(points), torch.rand(points, 3)

    def decoders_alone() -> None:
        geometry = ours.field.decoders.geometry(hashed, blob)
        color, _ = ours.field.decoders.color(geometry, blob)
        torch.autograd.backward([geometry[:, 0], color], [upstream_sdf, upstream_color])

    step_s, plain_s, decoders_s = median_seconds(ours.step, plain.step, decoders_alone, rounds=15)
    return [
        Row("step of 1024 rays x 43 samples", 1e3 * step_s, "ms"),
        Row("the same with the plain-torch grid", 1e3 * plain_s, "ms"),
        Row("its decoders alone, forward and backward", 1e3 * decoders_s, "ms"),
        Row("faster than with the plain-torch grid", plain_s / step_s, "x", least=8),
        Row("step / decoders alone", step_s / decoders_s, "x", most=2.5),
    ]
