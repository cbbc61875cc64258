"""What calibration measures: each stage of a replay at several sizes, ready to be run.

The stages work on the built-in room, in the state that they have some way into a replay.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.frame import Frame, SensorFrame
from proground_log.log.reader import LogReader
from proground_log.log.recording import Origin
from proground_log.log.registration import Registration
from proground_log.log.writer import open_writer
from proground_log.mapping.neural.config import NeuralConfig, SamplingConfig, SemanticsConfig
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.mapping.neural.semantic_learner import SemanticLearner
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.of_log import task_of_labels
from proground_log.perception.perceiver import Perceiver
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.run.settings import SimulationConfig
from proground_log.streams import stream

WITHOUT_MEANING = replace(NeuralConfig(), semantics=SemanticsConfig(enabled=False))
FRAMES = 8
"""Frames that the stages get in turn."""
WIDTHS = (160, 320, 480, 640)
"""Of the images that are decoded and inserted."""
RAYS = (256, 512, 1024, 1536, 2048)
SEMANTIC_RAYS = (96, 192, 384, 768, 1536)
"""Rays of a step; of a semantic one a third are of the background, as by default."""
IMAGES = (1, 2, 3)
"""Perceived in a row."""
KEYFRAME_EVERY = SimulationConfig().keyframe_every
"""Keyframes take longer to insert; what is measured is the mean."""
FRAMES_BEFORE, STEPS_BEFORE = 16, 10
"""What a mapper has seen and done before it is measured."""
COLOR_NOISE = 4
"""Most that a colour is off: smooth pictures decode faster than a camera's."""


class Work(NamedTuple):
    """A stage at one size.

    Args:
        units: the size, see `cost_model.UNITS`.
        run: does it.
        times: how often, in one call.
    """

    units: int
    run: Callable[[], object]
    times: int = 1


def stage_works(
    reader: LogReader, perceiver: Perceiver | None, folder: Path
) -> dict[str, Callable[[], list[Work]]]:
    """What makes the work of each stage ready, in the order of `cost_model.UNITS`.

    Args:
        reader: a log with labels and at least `FRAMES` frames, in one camera.
        perceiver: the perception to measure; None leaves the stage out.
        folder: for temporary logs.
    """
    sensors = list(reader.frames(range(FRAMES)))
    works = {"decode": partial(_decode_work, reader, sensors, folder)}
    if perceiver is not None:
        works["perceive"] = partial(_perceive_work, perceiver, sensors)
    works["insert"] = partial(_insert_work, reader, sensors)
    works["semantic_insert"] = partial(_semantic_insert_work, reader, sensors)
    works["step"] = partial(_step_work, reader, sensors)
    works["semantic_step"] = partial(_semantic_step_work, reader, sensors)
    return dict(works)


def _decode_work(reader: LogReader, sensors: Sequence[SensorFrame], folder: Path) -> list[Work]:
    """Read frames from a log and register them, as `replay.session` does."""
    works = []
    for camera in _cameras(reader):
        path = folder / f"{camera.width}.mcap"
        origin = Origin(reader.recording.source, reader.recording.format, {})
        with open_writer(path, Calibration.registered(camera), origin, {}, None) as writer:
            for sensor in sensors:
                # A robot's log has no true labels.
                writer.write(replace(_resized(sensor, camera), labels=None))
            recording = replace(reader.recording, frames=writer.frames)
            writer.finish(recording)
        log = LogReader(path)
        read = partial(_read, log, Registration(log.calibration))
        works.append(Work(2 * camera.width * camera.height, read, len(sensors)))
    return works


def _read(log: LogReader, register: Registration) -> None:
    for sensor in log.frames():
        register(sensor)


def _perceive_work(perceiver: Perceiver, sensors: Sequence[SensorFrame]) -> list[Work]:
    def perceive(count: int) -> None:
        for sensor in sensors[:count]:
            perceiver(sensor)

    return [Work(count, partial(perceive, count)) for count in IMAGES]


def _insert_work(reader: LogReader, sensors: Sequence[SensorFrame]) -> list[Work]:
    """Insert frames into a mapper of each size that learns no meaning."""
    works = []
    for camera in _cameras(reader):
        mapper, frames = _mapper_in_use(reader, sensors, camera, WITHOUT_MEANING)
        insert = partial(_insert, mapper, frames, KEYFRAME_EVERY)
        works.append(Work(camera.width * camera.height, insert, KEYFRAME_EVERY))
    return works


def _semantic_insert_work(reader: LogReader, sensors: Sequence[SensorFrame]) -> list[Work]:
    """Remember the regions of frames of each size."""
    works = []
    for camera in _cameras(reader):
        mapper, frames = _mapper_in_use(reader, sensors, camera, NeuralConfig())
        learn = partial(_learn, mapper, frames)
        works.append(Work(camera.width * camera.height, learn))
    return works


def _learn(mapper: OnlineMapper, frames: Iterator[Frame]) -> None:
    assert mapper.semantics is not None
    mapper.semantics.insert(next(frames), mapper.pixels)


def _insert(mapper: OnlineMapper, frames: Iterator[Frame], count: int) -> None:
    """Insert so many frames, every so many-th as a keyframe."""
    for number, frame in enumerate(itertools.islice(frames, count)):
        mapper.insert(frame, is_keyframe=number % KEYFRAME_EVERY == 0)


def _step_work(reader: LogReader, sensors: Sequence[SensorFrame]) -> list[Work]:
    """Steps of one mapper that learns no meaning."""
    config = WITHOUT_MEANING
    mapper, _ = _mapper_in_use(reader, sensors, reader.calibration.depth, config)
    _optimise(mapper)

    def step(rays: int) -> None:
        mapper.config = replace(config, sampling=SamplingConfig(rays=rays))
        mapper.step()

    samples = config.sampling.uniform + config.sampling.near_surface
    return [Work(rays * samples, partial(step, rays)) for rays in RAYS]


def _semantic_step_work(reader: LogReader, sensors: Sequence[SensorFrame]) -> list[Work]:
    """Steps of a learner of each size, beside the field of one mapper."""
    mapper, frames = _mapper_in_use(reader, sensors, reader.calibration.depth, NeuralConfig())
    _optimise(mapper)
    assert mapper.semantics is not None
    description = mapper.semantics.description
    seen = list(itertools.islice(frames, FRAMES))
    works = []
    for rays in SEMANTIC_RAYS:
        semantics = SemanticsConfig(rays=rays * 2 // 3, background_rays=rays // 3)
        config = replace(NeuralConfig(), semantics=semantics)
        learner = SemanticLearner(config, description, mapper.averaged, 0)
        for frame in seen:
            learner.insert(frame, np.flatnonzero(frame.depth_m > 0))
        step = partial(_semantic_step, learner, itertools.count())
        works.append(Work(rays * semantics.samples, step))
    return works


def _semantic_step(learner: SemanticLearner, iterations: Iterator[int]) -> None:
    learner.step(FRAMES, next(iterations))


def _mapper_in_use(
    reader: LogReader, sensors: Sequence[SensorFrame], camera: Camera, config: NeuralConfig
) -> tuple[OnlineMapper, Iterator[Frame]]:
    """A mapper some frames into a replay, and the frames that it would get next."""
    task = task_of_labels(reader, BuiltinTexts().knows)
    perceiver = SimulatedPerception(task, reader.label_names, camera, 0)
    register = Registration(Calibration.registered(camera))
    resized = (_resized(sensor, camera) for sensor in sensors)
    frames = [register(replace(sensor, regions=perceiver(sensor))) for sensor in resized]
    mapper = OnlineMapper(config, reader.recording.bounds, 0, "cpu", perceiver.description)
    numbered = zip(itertools.count(), itertools.cycle(frames))
    following = (replace(frame, index=index) for index, frame in numbered)
    _insert(mapper, following, FRAMES_BEFORE)
    return mapper, following


def _optimise(mapper: OnlineMapper) -> None:
    for _ in range(STEPS_BEFORE):
        mapper.step()


def _cameras(reader: LogReader) -> list[Camera]:
    return [reader.calibration.depth.scaled_to_width(width) for width in WIDTHS]


def _resized(sensor: SensorFrame, camera: Camera) -> SensorFrame:
    """The frame at another size, with some noise of its own."""
    size = (camera.width, camera.height)
    color = cv2.resize(sensor.decode_color(), size, interpolation=cv2.INTER_LINEAR)
    random = stream(0, "calibration", sensor.index, camera.width)
    noise = random.integers(-COLOR_NOISE, COLOR_NOISE, color.shape, endpoint=True)
    color = (color + noise).clip(0, 255).astype(np.uint8)
    _, encoded = cv2.imencode(".jpg", color[..., ::-1])
    assert sensor.labels is not None  # Or there would be no task.
    return replace(
        sensor,
        color=encoded.tobytes(),
        color_format="jpeg",
        depth=cv2.resize(sensor.depth, size, interpolation=cv2.INTER_NEAREST),
        labels=cv2.resize(sensor.labels, size, interpolation=cv2.INTER_NEAREST),
    )
