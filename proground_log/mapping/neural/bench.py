"""The neural mapper's stages at several sizes, to be measured."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from proground_log.camera import Camera
from proground_log.frame import Frame
from proground_log.mapping.bench import Bench, Work, Works
from proground_log.mapping.neural.config import NeuralConfig, SamplingConfig, SemanticsConfig
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.mapping.neural.semantic_learner import SemanticLearner

WITHOUT_MEANING = replace(NeuralConfig(), semantics=SemanticsConfig(enabled=False))
RAYS = (256, 512, 1024, 1536, 2048)
SEMANTIC_RAYS = (96, 192, 384, 768, 1536)
"""Rays of a step; of a semantic one a third are of the background, as by default."""
STEPS_BEFORE = 10
"""What a mapper has done before its steps are measured."""
FRAMES_LEARNT = 8
"""Frames that a semantic step draws from."""


def neural_works(bench: Bench) -> Works:
    """What makes the work of each of its stages ready."""
    return {
        "insert": partial(_insert_work, bench),
        "semantic_insert": partial(_semantic_insert_work, bench),
        "step": partial(_step_work, bench),
        "semantic_step": partial(_semantic_step_work, bench),
    }


def _insert_work(bench: Bench) -> list[Work]:
    """Insert frames of each size into a mapper that learns no meaning."""
    works = []
    for camera in bench.cameras:
        mapper, frames = _mapper_in_use(bench, camera, WITHOUT_MEANING)
        # Keyframes take longer: what is measured is the mean.
        insert = partial(bench.insert, mapper, frames, bench.keyframe_every)
        works.append(Work(camera.width * camera.height, insert, bench.keyframe_every))
    return works


def _semantic_insert_work(bench: Bench) -> list[Work]:
    """Remember the regions of frames of each size."""
    works = []
    for camera in bench.cameras:
        mapper, frames = _mapper_in_use(bench, camera, NeuralConfig())
        works.append(Work(camera.width * camera.height, partial(_learn, mapper, frames)))
    return works


def _learn(mapper: OnlineMapper, frames: Iterator[Frame]) -> None:
    assert mapper.semantics is not None
    mapper.semantics.insert(next(frames), mapper.pixels)


def _step_work(bench: Bench) -> list[Work]:
    """Steps of one mapper that learns no meaning."""
    mapper, _ = _mapper_in_use(bench, bench.own, WITHOUT_MEANING)
    mapper.steps(STEPS_BEFORE)

    def step(rays: int) -> None:
        mapper.config = replace(WITHOUT_MEANING, sampling=SamplingConfig(rays=rays))
        mapper.steps(1)

    sampling = WITHOUT_MEANING.sampling
    samples = sampling.uniform + sampling.near_surface
    return [Work(rays * samples, partial(step, rays)) for rays in RAYS]


def _semantic_step_work(bench: Bench) -> list[Work]:
    """Steps of a learner of each size, beside the field of one mapper."""
    mapper, frames = _mapper_in_use(bench, bench.own, NeuralConfig())
    mapper.steps(STEPS_BEFORE)
    seen = list(itertools.islice(frames, FRAMES_LEARNT))
    works = []
    for rays in SEMANTIC_RAYS:
        semantics = SemanticsConfig(rays=rays * 2 // 3, background_rays=rays // 3)
        config = replace(NeuralConfig(), semantics=semantics)
        learner = SemanticLearner(config, bench.perception, mapper.averaged, 0)
        for frame in seen:
            learner.insert(frame, np.flatnonzero(frame.depth_m > 0))
        step = partial(_semantic_step, learner, itertools.count())
        works.append(Work(rays * semantics.samples, step))
    return works


def _semantic_step(learner: SemanticLearner, iterations: Iterator[int]) -> None:
    learner.step(FRAMES_LEARNT, next(iterations))


def _mapper_in_use(
    bench: Bench, camera: Camera, config: NeuralConfig
) -> tuple[OnlineMapper, Iterator[Frame]]:
    """A mapper some frames into a replay, and the frames that it would get next."""
    mapper = OnlineMapper(config, bench.bounds, 0, "cpu", bench.perception)
    return mapper, bench.in_use(mapper, camera)
