"""Finds what is whole in a damaged or unfinished log; nothing is taken without its checksum.

A log is a row of records: opcode, length, content. After a damaged one the walk goes on where its
length leads to, or, where that cannot be, at the next bytes that begin like a record of a log.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from proground_log.log.bounded_stream import LARGEST_CHUNK_BYTES
from proground_log.log.reader import DAMAGE

MOST_RECORDS = 100_000
"""In a chunk; ours close once they hold 2 MiB. More would be there to fill the memory."""
MOST_READ = 20
"""Times the file's size, and a block: what the walk reads at most of a file that pretends to have
records within records without end."""

_HEAD = struct.Struct("<BQ")
_CHECKSUM = struct.Struct("<I")
_FOOTER_CHECKSUM = slice(-len(MCAP0_MAGIC) - _CHECKSUM.size, -len(MCAP0_MAGIC))
_IN_DATA = (
    Opcode.HEADER,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
    Opcode.DATA_END,
)
_CHANGED = "its checksum does not hold"
_BLOCK_BYTES = 2**12
_LONGEST_START = 100
_START = re.compile(
    rb"\x06.{36}\x04\0\0\0zstd"  # a chunk
    rb"|\x09.{24}.\0\0\0[a-z_]{1,40}\.[a-z]{1,20}"  # an attachment
    rb"|\x0c.{8}.\0\0\0proground\."  # metadata
    rb"|\x0f\x04\0{7}",  # the end of the data
    re.DOTALL,
)
_NAMES: dict[int, str] = {
    Opcode.CHUNK: "a chunk",
    Opcode.ATTACHMENT: "an attachment",
    Opcode.METADATA: "metadata",
    Opcode.DATA_END: "the index",
}
_UNDER_CHECKSUM: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}


@dataclass(frozen=True)
class Piece:
    """A piece of a log.

    Args:
        offset: where it begins, in bytes.
        records: what is in it: the schemas, channels and messages of a chunk, those of the index,
            one attachment, or one metadata record, which carries a checksum of its own.
        damage: what it seems to have been, in words, where it is not whole; else "".
    """

    offset: int
    records: list[McapRecord]
    damage: str = ""


class Salvage:
    """Walks over the bytes of a log.

    Args:
        stream: the file; read at any place.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._size = stream.seek(0, os.SEEK_END)
        self._read = 0

    def records_at(self, offset: int) -> list[McapRecord]:
        """The records of a piece that is known to be whole."""
        return _parsed(self._raw(offset))

    def pieces(self) -> Iterator[Piece]:
        """All pieces in the order of the file; a missing end is the last of them."""
        start = self._bytes(0, len(MCAP0_MAGIC))
        is_whole = start == MCAP0_MAGIC
        if not is_whole:
            yield Piece(0, [], "the beginning")
        offset, checksum = len(start), zlib.crc32(start)
        while offset < self._size and self._read <= MOST_READ * (self._size + _BLOCK_BYTES):
            try:
                raw = self._raw(offset)
                if raw[0] == Opcode.DATA_END:
                    yield Piece(offset, self._index(offset + len(raw)))
                    if is_whole and raw[_HEAD.size :] != _CHECKSUM.pack(checksum):
                        yield Piece(offset, [], "bytes between the chunks")
                    return
                records = _parsed(raw)
            except (*DAMAGE, ValueError) as error:
                following = self._following(offset)
                if following < self._size:
                    is_whole = False
                    name = _NAMES.get(self._bytes(offset, 1)[0], "a record")
                    yield Piece(offset, [], f"{name} at byte {offset} ({error})")
                offset = following
                continue
            checksum = zlib.crc32(raw, checksum)
            if records:
                yield Piece(offset, records)
            offset += len(raw)
        yield Piece(offset, [], "the end of the file")

    def _bytes(self, offset: int, count: int) -> bytes:
        self._stream.seek(offset)
        content = self._stream.read(count)
        self._read += len(content)
        return content

    def _end(self, offset: int) -> int:
        """Where a record ends; raises one of `DAMAGE` where there can be none."""
        opcode, length = _HEAD.unpack(self._bytes(offset, _HEAD.size))
        end = offset + _HEAD.size + length
        _require(opcode in _IN_DATA and end <= self._size, "no record of a log")
        return end

    def _raw(self, offset: int) -> bytes:
        return self._bytes(offset, self._end(offset) - offset)

    def _following(self, offset: int) -> int:
        """Where to go on after a damaged record; the file's size where nothing follows."""
        with suppress(*DAMAGE):
            following = self._end(offset)
            self._end(following)
            return following
        offset, count = offset + 1, _BLOCK_BYTES
        while block := self._bytes(offset, count):
            if found := _START.search(block):
                return offset + found.start()
            if len(block) < count:
                break
            offset, count = offset + count - _LONGEST_START, min(2 * count, 2**20)
        return self._size

    def _index(self, start: int) -> list[McapRecord]:
        """The schemas and channels that stand in the index, which begins after the data."""
        raw = self._bytes(start, self._size - start)
        covered, expected = raw[: _FOOTER_CHECKSUM.start], raw[_FOOTER_CHECKSUM]
        _require(raw.endswith(MCAP0_MAGIC), "its end is missing")
        _require(_CHECKSUM.pack(zlib.crc32(covered)) == expected, _CHANGED)
        return _split(covered + expected)


def _parsed(raw: bytes) -> list[McapRecord]:
    """The contents of a record of the data; raises one of `DAMAGE`, or ValueError."""
    opcode, content = raw[0], raw[_HEAD.size :]
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(stream)
        _require(stream.count == len(content), "its length is wrong")
        return _split(_uncompressed(chunk))
    if opcode == Opcode.ATTACHMENT:
        _require(content[-4:] == _CHECKSUM.pack(zlib.crc32(content[:-4])), _CHANGED)
        return [Attachment.read(stream)]
    if opcode == Opcode.METADATA:
        record = Metadata.read(stream)
        _require(stream.count == len(content), "its length is wrong")
        return [record]
    if opcode == Opcode.MESSAGE_INDEX:
        _require(content[2:6] == struct.pack("<I", len(content) - 6), "its length is wrong")
    return []


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise McapError(what)


def _uncompressed(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    # The library would make room for whatever size the compressed data say.
    is_sound = zstandard.frame_content_size(chunk.data) == size <= LARGEST_CHUNK_BYTES
    _require(is_sound, "its size is wrong")
    data = zstandard.decompress(chunk.data, size)
    _require(zlib.crc32(data) == chunk.uncompressed_crc, _CHANGED)
    return data


def _split(data: bytes) -> list[McapRecord]:
    """The schemas, channels and messages in bytes that a checksum covers.

    A record that does not fit is damage all the same: a writer can be stopped within one.
    """
    records: list[McapRecord] = []
    offset = 0
    while offset < len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        content = data[offset + _HEAD.size : offset + _HEAD.size + length]
        fits = len(content) == length and len(records) < MOST_RECORDS
        _require(fits, "its records do not fit")
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.MESSAGE:
            records.append(Message.read(stream, length))
        elif opcode in _UNDER_CHECKSUM:
            records.append(_UNDER_CHECKSUM[opcode].read(stream))
        offset += _HEAD.size + length
    return records
