"""A survey of a damaged or unfinished log: what is whole in it, and where."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.records import Attachment, Channel, Message, Metadata, Schema

from proground_log.log import topics
from proground_log.log.reader import FRAME_TOPICS, RawMessage
from proground_log.log.salvage import Salvage
from proground_log.log.schemas import schema_fault

IN_EVERY_FRAME = frozenset({*FRAME_TOPICS, topics.COLOR_INFO, topics.DEPTH_INFO})


@dataclass
class _Found:
    """What is there of a frame: its number, where its chunks begin, the channels in them."""

    number: int
    chunks: list[int] = field(default_factory=list)
    channels: set[int] = field(default_factory=set)
    is_beside_damage: bool = False


class Survey:
    """All that is whole in a log; of its messages no more than which frames they are of.

    Attributes:
        schemas, channels: by number; channels whose schema is not that of their topic are left out.
        metadata: by name; whether their checksums hold is for the caller to see.
        attachments: names of those that are whole.
        damage: the damaged places, in words.
        frames_seen: how many frames there must have been, by the frames' numbers.

    Args:
        stream: the file; stays open as long as the survey is used.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._salvage = Salvage(stream)
        self._frames: dict[int, _Found] = {}
        self._attachments: dict[str, int] = {}
        self._chunk: tuple[int, list[Message]] = (-1, [])
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.damage: list[str] = []
        self.frames_seen = 0
        last, is_damaged = _Found(-1), False
        for piece in self._salvage.pieces():
            if piece.damage:
                self.damage.append(piece.damage)
                last.is_beside_damage = is_damaged = True
            for record in piece.records:
                if isinstance(record, Message):
                    # A number is left out where somebody cut a chunk out.
                    is_damaged |= record.sequence - last.number not in (0, 1)
                    found = self._note(record, piece.offset)
                    if is_damaged:
                        last.is_beside_damage = found.is_beside_damage = True
                    last, is_damaged = found, False
                elif isinstance(record, Schema):
                    self.schemas.setdefault(record.id, record)
                elif isinstance(record, Channel):
                    self.channels.setdefault(record.id, record)
                elif isinstance(record, Metadata):
                    self.metadata.setdefault(record.name, record.metadata)
                elif isinstance(record, Attachment):
                    self._attachments.setdefault(record.name, piece.offset)
        self.attachments = tuple(self._attachments)
        self.channels = {
            number: channel
            for number, channel in sorted(self.channels.items())
            if not schema_fault(channel, self.schemas.get(channel.schema_id))
        }

    def _note(self, message: Message, chunk: int) -> _Found:
        found = self._frames.setdefault(message.log_time, _Found(message.sequence))
        found.channels.add(message.channel_id)
        if chunk not in found.chunks:
            found.chunks.append(chunk)
        self.frames_seen = max(self.frames_seen, message.sequence + 1)
        return found

    def _topics_of(self, found: _Found) -> set[str]:
        return {self.channels[number].topic for number in found.channels & self.channels.keys()}

    @property
    def has_nameless(self) -> bool:
        """Whether there are messages of whose topic nothing is known."""
        return any(found.channels - self.channels.keys() for found in self._frames.values())

    @property
    def frames_found(self) -> int:
        """How many frames there is anything of."""
        return len(self._frames)

    def whole_frames(self, without: frozenset[str] = frozenset()) -> list[int]:
        """The times of all frames that are whole, in order.

        A frame may lack what only some have, labels for instance; but beside a damaged place it
        counts as whole only with all topics of the log but TF_STATIC and those in `without`.
        """
        has = {time_ns: self._topics_of(found) for time_ns, found in self._frames.items()}
        every = {channel.topic for channel in self.channels.values()}
        every -= without | {topics.TF_STATIC}
        return sorted(
            time_ns
            for time_ns, topics_there in has.items()
            if topics_there >= IN_EVERY_FRAME
            and (topics_there >= every or not self._frames[time_ns].is_beside_damage)
        )

    def messages(self, time_ns: int) -> dict[str, RawMessage]:
        """A frame's messages by topic, in the order of the file; of several, the first."""
        group: dict[str, RawMessage] = {}
        for chunk in self._frames[time_ns].chunks:
            if chunk != self._chunk[0]:
                records = self._salvage.records_at(chunk)
                self._chunk = chunk, [part for part in records if isinstance(part, Message)]
            for message in self._chunk[1]:
                channel = self.channels.get(message.channel_id)
                if message.log_time == time_ns and channel is not None:
                    schema = self.schemas.get(channel.schema_id)
                    group.setdefault(channel.topic, (schema, channel, message))
        return group

    def mount(self) -> RawMessage | None:
        """Where the cameras sit, which one frame says, whole or not."""
        for time_ns, found in self._frames.items():
            if topics.TF_STATIC in self._topics_of(found):
                return self.messages(time_ns)[topics.TF_STATIC]
        return None

    def attachment(self, name: str) -> Attachment:
        """The attachment of this name."""
        [attachment] = self._salvage.records_at(self._attachments[name])
        assert isinstance(attachment, Attachment)
        return attachment
