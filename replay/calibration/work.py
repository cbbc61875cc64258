"""What calibration measures: each stage of a replay at several sizes, ready to be run.

The stages work on the built-in room, in the state that they have some way into a replay.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.frame import Frame, SensorFrame
from proground_log.log.reader import LogReader
from proground_log.log.recording import Origin
from proground_log.log.registration import Registration
from proground_log.log.writer import open_writer
from proground_log.mapping.bench import Bench, Work, Works
from proground_log.mapping.kinds import NEURAL, MapperKind, mapper_kind
from proground_log.mapping.mapper import Mapper
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.of_log import task_of_labels
from proground_log.perception.perceiver import Perceiver
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.run.settings import SimulationConfig
from proground_log.streams import stream

FRAMES = 8
"""Frames that the stages get in turn."""
WIDTHS = (160, 320, 480, 640)
"""Of the images that are decoded and inserted."""
IMAGES = (1, 2, 3)
"""Perceived in a row."""
COLOR_NOISE = 4
"""Most that a colour is off: smooth pictures decode faster than a camera's."""


def stage_works(
    reader: LogReader, perceiver: Perceiver | None, folder: Path, kind: str = NEURAL
) -> Works:
    """What makes the work of each stage ready.

    Args:
        reader: a log with labels and at least `FRAMES` frames, in one camera.
        perceiver: the perception to measure; None leaves the stage out.
        folder: for temporary logs.
        kind: the mapper whose stages are measured.
    """
    sensors = list(reader.frames(range(FRAMES)))
    works: Works = {"decode": partial(_decode_work, reader, sensors, folder)}
    if perceiver is not None:
        works["perceive"] = partial(_perceive_work, perceiver, sensors)
    mapper, bench = mapper_kind(kind), bench_of(reader, sensors)
    of_mapper = _by_protocol(mapper, bench) if mapper.works is None else mapper.works(bench)
    return {**works, **of_mapper}


def bench_of(reader: LogReader, sensors: Sequence[SensorFrame]) -> Bench:
    """What mappers are measured with, of some frames of a log with labels."""
    task = task_of_labels(reader, BuiltinTexts().knows)
    own = reader.calibration.depth.pinhole()

    def perceiver_of(camera: Camera) -> SimulatedPerception:
        return SimulatedPerception(task, reader.label_names, camera, 0)

    def frames_of(camera: Camera) -> Iterator[Frame]:
        perceiver, register = perceiver_of(camera), Registration(Calibration.registered(camera))
        resized = (_resized(sensor, camera) for sensor in sensors)
        frames = [register(replace(sensor, regions=perceiver(sensor))) for sensor in resized]
        numbered = zip(itertools.count(), itertools.cycle(frames))
        return (replace(frame, index=index) for index, frame in numbered)

    return Bench(
        reader.recording.bounds,
        perceiver_of(own).description,
        cameras_of(reader),
        own,
        frames_of,
        SimulationConfig().keyframe_every,
    )


def _by_protocol(kind: MapperKind, bench: Bench) -> Works:
    """The stages of a kind that brings no works of its own: what a replay does, timed whole."""
    settings = kind.settings()
    learns = kind.learns(settings)

    def mapper() -> Mapper:
        perception = bench.perception if learns else None
        return kind.make(settings, bounds=bench.bounds, seed=0, device="cpu", perception=perception)

    def insert_work() -> list[Work]:
        works = []
        for camera in bench.cameras:
            used = mapper()
            # Regions are measured apart.
            frames = (replace(f, regions=None, region_of=None) for f in bench.in_use(used, camera))
            insert = partial(bench.insert, used, frames, bench.keyframe_every)
            works.append(Work(camera.width * camera.height, insert, bench.keyframe_every))
        return works

    def regions_work() -> list[Work]:
        works = []
        for camera in bench.cameras:
            used = mapper()
            learn = partial(_learn_next, used, bench.in_use(used, camera))
            works.append(Work(camera.width * camera.height, learn))
        return works

    def step_work() -> list[Work]:
        used = mapper()
        bench.in_use(used, bench.own)
        return [Work(sum(work.step.values()), partial(used.steps, 1))]

    pixels = bench.own.width * bench.own.height
    work = kind.work(settings, pixels, learns=learns)
    works: Works = dict.fromkeys(work.insert, insert_work)
    works |= dict.fromkeys(work.regions, regions_work)
    return works | dict.fromkeys(work.step, step_work)


def _learn_next(mapper: Mapper, frames: Iterator[Frame]) -> None:
    mapper.insert_regions(next(frames))


def _decode_work(reader: LogReader, sensors: Sequence[SensorFrame], folder: Path) -> list[Work]:
    """Read frames from a log and register them, as `replay.session` does."""
    works = []
    for camera in cameras_of(reader):
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


def cameras_of(reader: LogReader) -> list[Camera]:
    """The sizes of images that are measured."""
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
