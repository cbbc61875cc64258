"""Looks for faults in a log: damaged bytes, time that runs back, impossible poses and depths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from mcap.records import Chunk, DataEnd, Message
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

from proground_log.camera import transform
from proground_log.errors import ProgroundError
from proground_log.log import topics
from proground_log.log.bounded_stream import BoundedStream
from proground_log.log.checking.consistency import Consistency
from proground_log.log.reader import (
    DAMAGE,
    FrameDecoder,
    LogReader,
    RawMessage,
    group_by_time,
)
from proground_log.log.registration import Registration
from proground_log.log.task_record import TaskRecord
from proground_log.regions import Regions

LEAST_INSIDE = 0.5
"""Share of a frame's depth that has to lie inside the log's bounds: they enclose 99 % of all."""

_RECOVER = "; `pglog recover` saves the rest"


@dataclass(frozen=True)
class Fault:
    """One thing wrong with a log; `topic` and `frame` are "" where they do not apply."""

    frame: str
    topic: str
    what: str


def check_log(path: Path, progress: Callable[[int, int], None]) -> list[Fault]:
    """Find every fault of a log.

    Args:
        path: the log; raises a ProgroundError where it is so damaged that it cannot be opened.
        progress: told the frames checked and the frames announced.
    """
    reader = LogReader(path)
    faults: list[Fault] = []
    calibration, register = None, None
    try:
        calibration = reader.calibration
        register = Registration(calibration)
    except ProgroundError as error:
        faults.append(Fault("", _topic_of(error), error.what))
    decode = FrameDecoder(calibration, where=path)
    order, consistency = _Order(), Consistency()
    progress(0, len(reader))
    for count, group in enumerate(group_by_time(_whole_messages(reader, faults)), start=1):
        index = group[0][2].sequence
        faults.extend(order.faults(group))
        faults.extend(_frame_faults(index, group, decode, register, reader, consistency))
        progress(count, len(reader))
    faults.extend(order.missing(len(reader)))
    faults.extend(Fault("", topics.TF, warning) for warning in consistency.report().warnings)
    return faults


class _Order:
    """Watches over the frames' numbers and times, which rise in the file."""

    def __init__(self) -> None:
        self._numbers: set[int] = set()
        self._last, self._last_ns = -1, -1

    def faults(self, group: list[RawMessage]) -> Iterator[Fault]:
        """What is wrong with where a frame stands."""
        number, time_ns = group[0][2].sequence, group[0][2].log_time
        if number in self._numbers:
            yield Fault(str(number), "", "comes again")
        elif time_ns <= self._last_ns:
            yield Fault(str(number), "", f"time does not increase after {self._last_ns} ns")
        elif number < self._last:
            yield Fault(str(number), "", f"comes after frame {self._last}")
        counts = Counter(channel.topic for _, channel, _ in group)
        for topic in sorted(topic for topic, count in counts.items() if count > 1):
            yield Fault(str(number), topic, "the message comes again")
        self._numbers.add(number)
        self._last, self._last_ns = number, max(self._last_ns, time_ns)

    def missing(self, announced: int) -> Iterator[Fault]:
        """The frames that were not there."""
        numbers = sorted(self._numbers)
        for before, after in pairwise([-1, *numbers]):
            if after - before == 2:
                yield Fault(str(before + 1), "", "is missing")
            elif after - before > 2:
                yield Fault(f"{before + 1} to {after - 1}", "", "are missing")
        end = numbers[-1] + 1 if numbers else 0
        if end != announced:
            what = f"{len(numbers)} frames found, {announced} announced"
            yield Fault("", "", what)


def _topic_of(error: ProgroundError) -> str:
    _, comma, topic = error.where.rpartition(", ")
    return topic if comma and topic.startswith("/") else ""


def _whole_messages(reader: LogReader, faults: list[Fault]) -> Iterator[RawMessage]:
    """All messages of undamaged chunks in file order; damage goes into `faults`."""
    last_frame, is_damaged, has_checksum = -1, False, False
    with reader.path.open("rb") as stream:
        bounded = cast(BinaryIO, BoundedStream(stream))
        records = StreamReader(bounded, emit_chunks=True, validate_crcs=True).records
        try:
            for record in records:
                if isinstance(record, DataEnd):
                    has_checksum = record.data_section_crc != 0
                if not isinstance(record, Chunk):
                    continue
                try:
                    parts = breakup_chunk(record, validate_crc=True)
                except DAMAGE as error:
                    start_s, end_s = record.message_start_time / 1e9, record.message_end_time / 1e9
                    what = (
                        f"a chunk, {start_s:.3f} s to {end_s:.3f} s, is damaged ({error}){_RECOVER}"
                    )
                    faults.append(Fault(_after(last_frame), "", what))
                    is_damaged = True
                    continue
                for part in parts:
                    if not isinstance(part, Message):
                        continue
                    last_frame = part.sequence
                    if channel := reader.channels.get(part.channel_id):
                        yield reader.schemas.get(channel.schema_id), channel, part
                    else:
                        what = f"a message of channel {part.channel_id}, which the index lacks"
                        faults.append(Fault(str(last_frame), "", what))
        except CRCValidationError:
            # Says that some byte of the file changed; a damaged chunk was named already.
            if not is_damaged:
                faults.append(Fault("", "", "the checksum over the whole file does not hold"))
        except DAMAGE as error:
            what = f"cannot be read on ({error or type(error).__name__}){_RECOVER}"
            faults.append(Fault(_after(last_frame), "", what))
        else:
            if not has_checksum:
                faults.append(Fault("", "", "has no checksum over the whole file"))


def _after(frame: int) -> str:
    return f"after {frame}" if frame >= 0 else "first"


def _frame_faults(
    index: int,
    group: list[RawMessage],
    decode: FrameDecoder,
    register: Registration | None,
    reader: LogReader,
    consistency: Consistency,
) -> Iterator[Fault]:
    """The faults of one frame."""
    name = str(index)
    try:
        sensor = decode(index, group)
    except ProgroundError as error:
        yield Fault(name, _topic_of(error), error.what)
        return
    if sensor.regions is not None:
        height, width = sensor.regions.owner.shape
        for what in _region_faults(sensor.regions, width, height, reader.task):
            yield Fault(name, topics.REGIONS, what)
    elif reader.task is not None:
        yield Fault(name, topics.REGIONS, "the message is missing")
    depth_m = sensor.depth_m
    if not np.isfinite(depth_m).all():
        yield Fault(name, topics.DEPTH, "has depths that are not finite")
        return
    if (depth_m < 0).any():
        yield Fault(name, topics.DEPTH, "has negative depths")
    if register is None:
        return
    consistency.add(sensor, reader.calibration)
    try:
        frame = register(sensor)
    except ProgroundError as error:
        yield Fault(name, _topic_of(error) or topics.COLOR, error.what)
        return
    valid = frame.depth_m > 0
    if not valid.any():
        yield Fault(name, topics.DEPTH, "has no depth at all")
        return
    points_m = transform(frame.world_from_camera, frame.camera.unproject(frame.depth_m)[valid])
    inside = float(reader.recording.bounds.contains(points_m).mean())
    if inside < LEAST_INSIDE:
        what = f"only {inside:.0%} of its depth lies inside the log's bounds"
        yield Fault(name, topics.DEPTH, what)


def _region_faults(
    regions: Regions, width: int, height: int, task: TaskRecord | None
) -> Iterator[str]:
    """What is wrong with the regions of an image of this size."""
    boxes, relevance = regions.boxes, regions.relevance
    if task is None:
        yield "has regions, and the log names no task"
    elif relevance.shape[1] != len(task.prompts):
        yield f"has relevance to {relevance.shape[1]} prompts, the task has {len(task.prompts)}"
    # Written so that numbers that are not finite fail as well.
    start, end = boxes[:, :2], boxes[:, 2:]
    if not ((start >= 0) & (start <= end) & (end <= (width, height))).all():
        yield f"has a box that is not finite or not inside the image of {width}x{height}"
    if not ((relevance >= 0) & (relevance <= 1)).all():
        yield "has a relevance that is not from 0 to 1"
    if not np.isfinite(regions.embeddings).all():
        yield "has an embedding that is not finite"
