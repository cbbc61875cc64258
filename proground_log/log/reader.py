"""Reads a log back: every checksum verified, nothing held but the frame at hand."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, cast

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import AttachmentIndex, Channel, Message, Schema, Statistics
from mcap.stream_reader import CRCValidationError
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import PARTIAL, require_file
from proground_log.frame import SensorFrame
from proground_log.log import messages, topics
from proground_log.log.bounded_stream import BoundedStream
from proground_log.log.recording import Recording
from proground_log.log.region_message import regions_of
from proground_log.log.schemas import schema_fault
from proground_log.log.task_record import TaskRecord

DAMAGE = (
    McapError,
    CRCValidationError,
    zstandard.ZstdError,
    struct.error,
    UnicodeDecodeError,
    OverflowError,
    MemoryError,
)
"""What the libraries raise on bytes that are not as they were written; the last two where a
length became absurd."""

_REMEDY = "copy or record it again, or save its whole frames with `pglog recover`"

_FOOTER = struct.Struct("<BQQQI")
"""Opcode, length, start of the summary, start of its offsets, checksum."""

_LENGTH = struct.Struct("<Q")
_CHECKSUM_BYTES = 4

FRAME_TOPICS = (topics.TF, topics.COLOR, topics.DEPTH)
"""Topics that every frame must have."""


class MessageDecoder:
    """Decodes ROS 2 messages by their schema."""

    def __init__(self) -> None:
        self._factory = DecoderFactory()

    def __call__(self, schema: Schema | None, message: Message, *, where: object) -> Any:
        """Decode a message; raises a ProgroundError where it does not follow its schema."""
        decode = self._factory.decoder_for("cdr", schema)
        try:
            if decode is not None:
                return decode(message.data)
        except (struct.error, ValueError, IndexError, MemoryError):
            pass
        raise ProgroundError(
            "the message cannot be decoded", where=where, todo="record the log again"
        )


class LogReader:
    """A log on disk.

    Args:
        path: the `.mcap` file. Raises a ProgroundError unless it is a whole log of this schema.
    """

    def __init__(self, path: Path) -> None:
        self.path = require_file(path)
        with self.path.open("rb") as stream:
            _require_whole_summary(stream, path)
        with self._reader() as reader:
            summary = reader.get_summary()
            metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        if summary is None or topics.RECORDING_METADATA not in metadata:
            raise ProgroundError(
                "is an MCAP file, but not a log of pglog",
                where=path,
                todo="make one with `pglog record`",
            )
        self.statistics: Statistics | None = summary.statistics
        self.schemas: dict[int, Schema] = summary.schemas
        self.channels: dict[int, Channel] = summary.channels
        self.attachments: list[AttachmentIndex] = summary.attachment_indexes
        self.metadata: dict[str, dict[str, str]] = metadata
        for _, channel in sorted(self.channels.items()):
            if fault := schema_fault(channel, self.schemas.get(channel.schema_id)):
                where = f"{path}, {channel.topic}"
                raise ProgroundError(fault, where=where, todo="record it again")
        self.recording = Recording.from_metadata(metadata[topics.RECORDING_METADATA], where=path)
        task = metadata.get(topics.TASK_METADATA)
        self.task = None if task is None else TaskRecord.from_metadata(task, where=path)

    def __len__(self) -> int:
        return self.recording.frames

    @contextmanager
    def _reader(self) -> Iterator[Any]:
        """The library's reader of the file; damage that it meets becomes a ProgroundError."""
        with self.path.open("rb") as stream, self._damage_named():
            yield make_reader(cast(BinaryIO, BoundedStream(stream)), validate_crcs=True)

    @contextmanager
    def _damage_named(self) -> Iterator[None]:
        try:
            yield
        # A KeyError: the library looks up what a chunk names, and the index lacks it.
        except (*DAMAGE, KeyError) as error:
            is_unknown = isinstance(error, KeyError)
            what = f"its index lacks number {error}" if is_unknown else error
            raise ProgroundError(
                f"the file is damaged ({what or type(error).__name__})",
                where=self.path,
                todo=_REMEDY,
            ) from error

    @cached_property
    def calibration(self) -> Calibration:
        """The rig's cameras, as the first frame has them."""
        found: dict[str, Any] = {}
        wanted = (topics.COLOR_INFO, topics.DEPTH_INFO, topics.TF_STATIC)
        decode = MessageDecoder()
        with self._reader() as reader:
            for schema, channel, message in reader.iter_messages(topics=wanted):
                where = f"{self.path}, {channel.topic}"
                found.setdefault(channel.topic, decode(schema, message, where=where))
                if len(found) == len(wanted):
                    break
        missing = [topic for topic in wanted if topic not in found]
        if missing:
            raise ProgroundError(
                f"has no {' and no '.join(missing)}", where=self.path, todo="record it again"
            )
        mount = f"{self.path}, {topics.TF_STATIC}"
        return Calibration(
            color=messages.camera(found[topics.COLOR_INFO], where=self.path),
            depth=messages.camera(found[topics.DEPTH_INFO], where=self.path),
            depth_from_color=require_rigid(
                messages.parent_from_child(found[topics.TF_STATIC], where=mount),
                where=mount,
            ),
        )

    @property
    def label_names(self) -> dict[int, str]:
        """Class names by label; empty where the log has no ground truth."""
        attachment = self.attachment(topics.LABEL_NAMES_ATTACHMENT)
        try:
            names = json.loads(attachment) if attachment else {}
            return {int(label): str(name) for label, name in names.items()}
        except (ValueError, AttributeError, RecursionError) as error:
            where = f"{self.path}, {topics.LABEL_NAMES_ATTACHMENT}"
            what = f"does not name the labels ({error})"
            raise ProgroundError(what, where=where, todo="record it again") from error

    def attachment(self, name: str) -> bytes | None:
        """The bytes of an attachment, or None where the log has none of that name."""
        for index in self.attachments:
            if index.name != name:
                continue
            with self.path.open("rb") as file, self._damage_named():
                stream = BoundedStream(file)
                stream.seek(index.offset)
                record = stream.read(index.length)
                # The library does not look at this checksum: of all but opcode, length and itself.
                if zlib.crc32(record[9:-4]) != int.from_bytes(record[-4:], "little"):
                    raise McapError(f"the checksum of the attachment {name} does not hold")
                return record[-4 - index.data_size : -4]
        return None

    def groups(self) -> Iterator[list[RawMessage]]:
        """The messages of each frame, as they stand in the file."""
        count = 0
        with self._reader() as reader:
            for group in group_by_time(reader.iter_messages()):
                yield group
                count += 1
        if count != len(self):
            what = f"frame {count} is missing" if count < len(self) else f"has {count} frames"
            raise ProgroundError(
                f"{what}, the log announces {len(self)}",
                where=self.path,
                todo="see `pglog check`, or record it again",
            )

    def stamps_ns(self) -> list[int]:
        """The time of each frame; nothing but that is decoded."""
        return [group[0][2].log_time for group in self.groups()]

    def frames(self, chosen: Sequence[int] | None = None) -> Iterator[SensorFrame]:
        """The frames of these numbers (ascending), or all; only they are decoded."""
        wanted = iter(range(len(self)) if chosen is None else chosen)
        following = next(wanted, None)
        decode = FrameDecoder(self.calibration, where=self.path)
        for index, group in enumerate(self.groups()):
            if following is None:
                return
            if index == following:
                yield decode(index, group)
                following = next(wanted, None)


def _require_whole_summary(stream: BinaryIO, path: Path) -> None:
    """Raise a ProgroundError unless this is an MCAP file with its end and an undamaged index.

    The library leaves the checksum of the index alone, and everything hangs on the index.
    """
    magic = len(MCAP0_MAGIC)
    if stream.read(magic) != MCAP0_MAGIC:
        raise ProgroundError(
            "is no MCAP file", where=path, todo="give a log, made with `pglog record`"
        )
    end = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, end - _FOOTER.size - magic))
    footer, last = stream.read(_FOOTER.size), stream.read()
    if last != MCAP0_MAGIC:
        is_partial = path.suffix == PARTIAL
        what = "the recording was stopped before its end" if is_partial else "the file is cut off"
        raise ProgroundError(what, where=path, todo=_REMEDY)
    *_, start, _, checksum = _FOOTER.unpack(footer)
    # The length of the record that ends the data, the one number that no checksum covers.
    stream.seek(max(0, min(start, end) - _LENGTH.size - _CHECKSUM_BYTES))
    if start and stream.read(_LENGTH.size) != _LENGTH.pack(_CHECKSUM_BYTES):
        raise ProgroundError(
            "the file is damaged: its data do not end as they should",
            where=path,
            todo=_REMEDY,
        )
    stream.seek(min(start, end))
    covered = stream.read(max(0, end - start - magic - 4))
    if start and checksum and zlib.crc32(covered) != checksum:
        raise ProgroundError(
            "the file is damaged: the checksum of its index does not hold",
            where=path,
            todo=_REMEDY,
        )


RawMessage = tuple[Schema | None, Any, Message]


def group_by_time(raw: Iterable[RawMessage]) -> Iterator[list[RawMessage]]:
    """Gather messages of equal log time: the messages of one frame."""
    group: list[RawMessage] = []
    for item in raw:
        if group and item[2].log_time != group[0][2].log_time:
            yield group
            group = []
        group.append(item)
    if group:
        yield group


class FrameDecoder:
    """Makes frames of their messages.

    Args:
        calibration: the recording's cameras; None where they are not known, and then no frame
            tells of its own.
        where: the log.
    """

    def __init__(self, calibration: Calibration | None, *, where: object) -> None:
        self._calibration, self._where = calibration, where
        self._decode = MessageDecoder()
        self._cameras: dict[str, tuple[bytes, Camera]] = {}

    def __call__(self, index: int, group: list[RawMessage]) -> SensorFrame:
        """Decode a frame; raises a ProgroundError that names frame and topic."""
        wanted = (*FRAME_TOPICS, topics.LABELS, topics.INSTANCES, topics.REGIONS)
        at = f"{self._where}, frame {index}, "
        found = {
            channel.topic: self._decode(schema, message, where=at + channel.topic)
            for schema, channel, message in group
            if channel.topic in wanted
        }
        for topic in FRAME_TOPICS:
            if topic not in found:
                raise ProgroundError(
                    "the message is missing", where=at + topic, todo="record the log again"
                )
        labels, instances = (
            messages.image_pixels(found[topic], where=at + topic) if topic in found else None
            for topic in (topics.LABELS, topics.INSTANCES)
        )
        regions = found.get(topics.REGIONS)
        return SensorFrame(
            index=index,
            stamp_ns=group[0][2].log_time,
            color_stamp_ns=messages.stamp_ns(found[topics.COLOR]),
            color=found[topics.COLOR].data,
            color_format=found[topics.COLOR].format,
            depth=messages.image_pixels(found[topics.DEPTH], where=at + topics.DEPTH),
            world_from_camera=require_rigid(
                messages.parent_from_child(found[topics.TF], where=at + topics.TF),
                where=at + topics.TF,
            ),
            labels=labels,
            instances=instances,
            calibration=self._own_calibration(group, at),
            regions=None if regions is None else regions_of(regions, where=at + topics.REGIONS),
        )

    def _own_calibration(self, group: list[RawMessage], at: str) -> Calibration | None:
        """The frame's cameras, where they are not the recording's."""
        known = self._calibration
        if known is None:
            return None
        own = {topics.COLOR_INFO: known.color, topics.DEPTH_INFO: known.depth}
        for schema, channel, message in group:
            if channel.topic not in own:
                continue
            # Mostly nothing but the time differs from the frame before, and decoding is slow.
            content = messages.without_stamp(message.data)
            last = self._cameras.get(channel.topic)
            if last is None or last[0] != content:
                where = at + channel.topic
                camera = messages.camera(self._decode(schema, message, where=where), where=where)
                last = self._cameras[channel.topic] = content, camera
            own[channel.topic] = last[1]
        color, depth = own[topics.COLOR_INFO], own[topics.DEPTH_INFO]
        if (color, depth) == (known.color, known.depth):
            return None
        return replace(known, color=color, depth=depth)
