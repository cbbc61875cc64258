"""Reads a log back: every checksum verified, nothing held but the frame at hand."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Message, Schema, Statistics
from mcap.stream_reader import CRCValidationError
from mcap_ros2.decoder import DecoderFactory

from proground_log.camera import Calibration, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.frame import SensorFrame
from proground_log.log import messages, topics
from proground_log.log.recording import Recording

DAMAGE = (McapError, CRCValidationError, zstandard.ZstdError, struct.error)
"""What the libraries raise on bytes that are not as they were written."""

FRAME_TOPICS = (topics.TF, topics.COLOR, topics.DEPTH)
"""Topics that every frame must have."""


class MessageDecoder:
    """Decodes ROS 2 messages by their schema."""

    def __init__(self) -> None:
        self._factory = DecoderFactory()

    def __call__(self, schema: Schema | None, message: Message) -> Any:
        decode = self._factory.decoder_for("cdr", schema)
        return decode(message.data) if decode else None


class LogReader:
    """A log on disk.

    Args:
        path: the `.mcap` file. Raises a ProgroundError unless it is a whole log of this schema.
    """

    def __init__(self, path: Path) -> None:
        self.path = require_file(path)
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
        self.topics = {channel.topic: channel.id for channel in summary.channels.values()}
        self.recording = Recording.from_metadata(metadata[topics.RECORDING_METADATA], where=path)

    def __len__(self) -> int:
        return self.recording.frames

    @contextmanager
    def _reader(self) -> Iterator[Any]:
        with self.path.open("rb") as stream:
            try:
                yield make_reader(stream, validate_crcs=True)
            except DAMAGE as error:
                raise ProgroundError(
                    f"the file is damaged or cut off ({error})",
                    where=self.path,
                    todo="see `pglog check`, or record it again",
                ) from error

    @cached_property
    def calibration(self) -> Calibration:
        """The rig's cameras, as the first frame has them."""
        found: dict[str, Any] = {}
        wanted = (topics.COLOR_INFO, topics.DEPTH_INFO, topics.TF_STATIC)
        decode = MessageDecoder()
        with self._reader() as reader:
            for schema, channel, message in reader.iter_messages(topics=wanted):
                found.setdefault(channel.topic, decode(schema, message))
                if len(found) == len(wanted):
                    break
        missing = [topic for topic in wanted if topic not in found]
        if missing:
            raise ProgroundError(
                f"has no {' and no '.join(missing)}", where=self.path, todo="record it again"
            )
        return Calibration(
            color=messages.camera(found[topics.COLOR_INFO]),
            depth=messages.camera(found[topics.DEPTH_INFO]),
            depth_from_color=require_rigid(
                messages.parent_from_child(found[topics.TF_STATIC], where=topics.TF_STATIC),
                where=f"{self.path}, {topics.TF_STATIC}",
            ),
        )

    @property
    def label_names(self) -> dict[int, str]:
        """Class names by label; empty where the log has no ground truth."""
        attachment = self.attachment(topics.LABEL_NAMES_ATTACHMENT)
        names = json.loads(attachment) if attachment else {}
        return {int(label): name for label, name in names.items()}

    def attachment(self, name: str) -> bytes | None:
        """The bytes of an attachment, or None where the log has none of that name."""
        with self._reader() as reader:
            attachment: Attachment
            for attachment in reader.iter_attachments():
                if attachment.name == name:
                    return attachment.data
        return None

    def frames(self, chosen: Sequence[int] | None = None) -> Iterator[SensorFrame]:
        """The frames of these numbers (ascending), or all; only they are decoded."""
        wanted = iter(range(len(self)) if chosen is None else chosen)
        following = next(wanted, None)
        decode = MessageDecoder()
        with self._reader() as reader:
            groups = group_by_time(reader.iter_messages())
            for index, group in enumerate(groups):
                if following is None:
                    return
                if index == following:
                    yield decode_frame(index, group, decode, where=self.path)
                    following = next(wanted, None)
        if following is not None:
            raise ProgroundError(
                f"frame {following} is missing, the log announces {len(self)}",
                where=self.path,
                todo="see `pglog check`, or record it again",
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


def decode_frame(
    index: int, group: list[RawMessage], decode: MessageDecoder, *, where: object
) -> SensorFrame:
    """Make a frame of its messages; raises a ProgroundError that names frame and topic."""
    wanted = (*FRAME_TOPICS, topics.LABELS)
    found = {
        channel.topic: decode(schema, message)
        for schema, channel, message in group
        if channel.topic in wanted
    }
    for topic in FRAME_TOPICS:
        if topic not in found:
            raise ProgroundError(
                f"has no {topic}", where=f"{where}, frame {index}", todo="record the log again"
            )
    labels = found.get(topics.LABELS)
    at = f"{where}, frame {index}, "
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
        labels=None if labels is None else messages.image_pixels(labels, where=at + topics.LABELS),
    )
