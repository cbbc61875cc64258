"""Bags of ROS 2 in MCAP files, read chunk by chunk, every checksum that they have verified.

Messages are decoded by the public definitions of their types, not by those in the file: these
types are fixed, and a file's own could be made to hurt.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, MetadataIndex, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.log import topics
from proground_log.log.messages import DEFINITIONS
from proground_log.log.reader import DAMAGE
from recorders.formats.ros.definitions import POSE_DEFINITIONS
from recorders.formats.ros.topics import Key
from recorders.reading.association import SECOND_NS

RECOVER = "mend it with `mcap recover IN -o OUT` (or `ros2 bag reindex` for a folder)"
LARGEST_CHUNK = 2**29
"""Bytes of a chunk unpacked; recorders make chunks of one or a few megabytes."""
_FOOTER = struct.Struct("<BQQQI")
_CHUNK = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, number, log time, publish time."""


@dataclass(frozen=True)
class Summary:
    """The index of an MCAP file.

    Args:
        size: bytes of the file.
        schemas, channels: by number.
        chunks: in the order of the file.
        metadata: names of the metadata records.
    """

    size: int
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: list[ChunkIndex]
    metadata: frozenset[str]


def read_summary(path: Path) -> Summary:
    """Read the index of an MCAP file.

    Raises:
        ProgroundError: no MCAP file, one without an index, or one whose index is damaged.
    """
    magic = len(MCAP0_MAGIC)
    with require_file(path).open("rb") as stream, _damage_named(path):
        if stream.read(magic) != MCAP0_MAGIC:
            raise ProgroundError("is no MCAP file", where=path, todo="give a bag of ROS 2 in MCAP")
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - _FOOTER.size - magic))
        footer, end = stream.read(_FOOTER.size), stream.read()
        if end != MCAP0_MAGIC:
            raise ProgroundError("the bag is cut off, it has no index", where=path, todo=RECOVER)
        opcode, _, start, _, checksum = _FOOTER.unpack(footer)
        if start == 0:
            raise ProgroundError("the bag has no index", where=path, todo=RECOVER)
        if opcode != Opcode.FOOTER or start > size:
            raise McapError("its end is not as it should be")
        stream.seek(start)
        content = stream.read()
        if checksum and zlib.crc32(content[: -magic - 4]) != checksum:
            raise McapError("the checksum of its index does not hold")
        records = list(StreamReader(io.BytesIO(content), skip_magic=True).records)
    found = Summary(
        size,
        {each.id: each for each in records if isinstance(each, Schema)},
        {each.id: each for each in records if isinstance(each, Channel)},
        sorted(
            (each for each in records if isinstance(each, ChunkIndex)),
            key=lambda each: each.chunk_start_offset,
        ),
        frozenset(each.name for each in records if isinstance(each, MetadataIndex)),
    )
    if found.channels and not found.chunks:
        raise ProgroundError("the bag has no index of chunks", where=path, todo=RECOVER)
    return found


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Turn what libraries raise on damaged bytes into a ProgroundError."""
    try:
        yield
    except DAMAGE as error:
        raise ProgroundError(
            f"the bag is damaged ({error or type(error).__name__})", where=path, todo=RECOVER
        ) from error


class McapBag:
    """One or several MCAP files of one recording.

    Args:
        path: what the user gave, for messages.
        files: the MCAP files.

    Raises:
        ProgroundError: a file has no index or is damaged, or is a log of pglog already.
    """

    def __init__(self, path: Path, files: Iterable[Path]) -> None:
        self.path = path
        self._files = [(file, read_summary(file)) for file in files]
        self.types: dict[str, str] = {}
        for file, summary in self._files:
            if is_own_log(summary):
                raise ProgroundError(
                    "is a log of pglog already",
                    where=file,
                    todo="use it as it is, for instance with `pglog replay`",
                )
            self.types.update(ros_types(summary))
        self._decoders = {name: _decoder(name) for name in _DEFINITIONS}

    def scan(self, topics: Iterable[str]) -> Iterator[tuple[str, Key, bytes]]:
        """Topic, place and bytes of each message of these topics, as they stand in the files."""
        wanted = set(topics)
        for number, (file, summary) in enumerate(self._files):
            names = {
                channel.id: channel.topic
                for channel in summary.channels.values()
                if channel.topic in wanted and channel.message_encoding == "cdr"
            }
            for chunk_number, chunk in enumerate(summary.chunks):
                # A chunk without an index of its own may have anything in it.
                if chunk.message_index_offsets and not names.keys() & chunk.message_index_offsets:
                    continue
                data = _unpacked(file, summary.size, chunk)
                for channel_id, at, length in _messages(data, file):
                    if channel_id in names:
                        key = (number, chunk_number, at, length)
                        yield names[channel_id], key, data[at : at + length]

    def read(self, topic: str, key: Key) -> Any:
        """The message at a place, decoded."""
        number, chunk_number, at, length = key
        file, summary = self._files[number]
        data = _unpacked(file, summary.size, summary.chunks[chunk_number])
        return self.decode(topic, data[at : at + length])

    def decode(self, topic: str, data: bytes) -> Any:
        """A message of a topic, decoded; raises a ProgroundError where it is damaged."""
        try:
            return self._decoders[self.types[topic]](data)
        except (*DAMAGE, ValueError, IndexError) as error:
            raise self._undecodable(topic) from error

    def stamp_ns(self, topic: str, data: bytes) -> int:
        """The time in the header that a message begins with, in nanoseconds.

        It follows the four bytes of CDR's encapsulation, the second of which tells the order.
        """
        if len(data) < 12:
            raise self._undecodable(topic)
        seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
        if seconds < 0 or nanoseconds >= SECOND_NS:
            raise self._undecodable(topic)
        return seconds * SECOND_NS + nanoseconds

    def _undecodable(self, topic: str) -> ProgroundError:
        what = f"a message is no {self.types[topic]}"
        return ProgroundError(what, where=f"{self.path}, {topic}", todo=RECOVER)


def is_own_log(summary: Summary) -> bool:
    """Whether an MCAP file was written by `pglog record`."""
    return topics.RECORDING_METADATA in summary.metadata


def ros_types(summary: Summary) -> dict[str, str]:
    """The types of ROS 2 messages by topic."""
    return {
        channel.topic: summary.schemas[channel.schema_id].name
        for _, channel in sorted(summary.channels.items())
        if channel.message_encoding == "cdr" and channel.schema_id in summary.schemas
    }


_DEFINITIONS = {**DEFINITIONS, **POSE_DEFINITIONS}


def _decoder(message_type: str) -> Callable[[bytes], Any]:
    definition = _DEFINITIONS[message_type].encode()
    schema = Schema(id=1, name=message_type, encoding="ros2msg", data=definition)
    decode = DecoderFactory().decoder_for("cdr", schema)
    assert decode is not None
    return decode


def _unpacked(file: Path, file_size: int, index: ChunkIndex) -> bytes:
    """The content of a chunk, its size bounded before and its checksum verified after."""
    offset, length = index.chunk_start_offset, index.chunk_length
    with _damage_named(file):
        if offset + length > file_size:
            raise McapError("a chunk goes beyond the end of the file")
        with file.open("rb") as stream:
            stream.seek(offset)
            record = stream.read(length)
        _, _, size, checksum, name_length = _CHUNK.unpack_from(record, _RECORD.size)
        at = _RECORD.size + _CHUNK.size + name_length
        compression = record[_RECORD.size + _CHUNK.size : at].decode()
        (packed_length,) = _LENGTH.unpack_from(record, at)
        packed = record[at + _LENGTH.size :]
        if size > LARGEST_CHUNK or packed_length != len(packed):
            raise McapError(f"a chunk says that it has {size} bytes, packed {packed_length}")
        try:
            data = _UNPACK[compression](packed, size)
        except (KeyError, RuntimeError) as error:
            raise McapError(f"a chunk cannot be unpacked, by {compression!r}") from error
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            raise McapError("the checksum of a chunk does not hold")
        return data


def _unpack_zstd(packed: bytes, size: int) -> bytes:
    announced = zstandard.frame_content_size(packed)
    if announced not in (-1, size):
        raise McapError(f"a chunk of {size} bytes announces {announced}")
    return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size) if size else b""


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, _: packed,
    "zstd": _unpack_zstd,
    "lz4": lambda packed, size: bytes(LZ4FrameDecompressor().decompress(packed, max_length=size)),
}


def _messages(data: bytes, file: Path) -> Iterator[tuple[int, int, int]]:
    """Channel, start and length of the content of each message in a chunk."""
    at = 0
    with _damage_named(file):
        while at < len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if at + length > len(data) or (opcode == Opcode.MESSAGE and length < _MESSAGE.size):
                raise McapError("a message goes beyond the end of its chunk")
            if opcode == Opcode.MESSAGE:
                channel_id, *_ = _MESSAGE.unpack_from(data, at)
                yield channel_id, at + _MESSAGE.size, length - _MESSAGE.size
            at += length
