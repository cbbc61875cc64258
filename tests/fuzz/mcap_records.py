"""MCAP files with a record changed, and lengths, offsets and checksums made right again."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Chunk, ChunkIndex, Metadata, MetadataIndex
from mcap.writer import MCAP0_MAGIC

from proground_log.log.recording import CHECKSUM, checksum
from tests.fuzz.mutations import of_bytes, of_words

BOMB_BYTES = 2**30
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD_BYTES = 22
_INDEXES: dict[int, Any] = {
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
}


def of_mcap(data: bytes, rng: np.random.Generator) -> bytes:
    """An MCAP file of which one record of the data or of the index is changed."""
    records = list(_records(data, len(MCAP0_MAGIC)))
    end = next(i for i, (_, opcode, _) in enumerate(records) if opcode == Opcode.DATA_END)
    # Chunks are few among the indices of their messages, and the most is in them.
    chunks = [i for i in range(end) if records[i][1] == Opcode.CHUNK]
    chosen = int(rng.choice(chunks) if rng.random() < 0.5 else rng.integers(len(records) - 1))
    offset, opcode, content = records[chosen]
    chunk = None
    if opcode == Opcode.CHUNK:
        chunk = _changed_chunk(Chunk.read(ReadDataStream(io.BytesIO(content))), rng)
        content = _built(chunk)[_HEAD.size :]
    elif opcode == Opcode.METADATA:
        content = _changed_metadata(content, rng)
    elif opcode == Opcode.ATTACHMENT:
        content = of_bytes(content[:-4], rng)
        content += zlib.crc32(content).to_bytes(4, "little")
    elif opcode != Opcode.DATA_END:
        content = of_bytes(content, rng)
    records[chosen] = offset, opcode, content
    return _written(records, chosen, chunk)


def with_first_chunk(data: bytes, packed: bytes) -> bytes:
    """An MCAP file whose first chunk holds these bytes, and is as before in what it says."""
    records = list(_records(data, len(MCAP0_MAGIC)))
    chosen = next(i for i, (_, opcode, _) in enumerate(records) if opcode == Opcode.CHUNK)
    offset, opcode, content = records[chosen]
    chunk = replace(Chunk.read(ReadDataStream(io.BytesIO(content))), data=packed)
    records[chosen] = offset, opcode, _built(chunk)[_HEAD.size :]
    return _written(records, chosen, chunk)


def _records(data: bytes, at: int) -> Iterator[tuple[int, int, bytes]]:
    """Offset, opcode and content of records up to the footer, or of all in a chunk."""
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        yield at, opcode, data[at + _HEAD.size : at + _HEAD.size + length]
        at += _HEAD.size + length
        if opcode == Opcode.FOOTER:
            return


def _written(records: list[tuple[int, int, bytes]], chosen: int, chunk: Chunk | None) -> bytes:
    """The file of these records, of which one, perhaps a chunk, is not as the index says."""
    moved, written, summary_start, summary_offsets_start = {}, bytearray(MCAP0_MAGIC), 0, 0
    for number, (offset, opcode, content) in enumerate(records):
        moved[offset] = len(written), _HEAD.size + len(content)
        if opcode == Opcode.DATA_END:
            content = zlib.crc32(written).to_bytes(4, "little")
        elif opcode == Opcode.FOOTER:
            start = struct.pack("<QQ", summary_start, summary_offsets_start)
            covered = bytes(written[summary_start:]) + _HEAD.pack(opcode, 20) + start
            content = start + zlib.crc32(covered).to_bytes(4, "little")
        elif opcode in _INDEXES and number != chosen:
            content = _moved(_INDEXES[opcode], content, moved, records[chosen][0], chunk)
        elif opcode == Opcode.SUMMARY_OFFSET:
            summary_offsets_start = summary_offsets_start or len(written)
        written += _HEAD.pack(opcode, len(content)) + content
        if opcode == Opcode.DATA_END:
            summary_start = len(written)
    return bytes(written) + MCAP0_MAGIC


def _moved(
    kind: Any, content: bytes, moved: dict[int, tuple[int, int]], changed: int, chunk: Chunk | None
) -> bytes:
    """An index, told where the record that it is about has gone."""
    index = kind.read(ReadDataStream(io.BytesIO(content)))
    if isinstance(index, ChunkIndex):
        if chunk is not None and index.chunk_start_offset == changed:
            index.compressed_size = len(chunk.data)
            index.uncompressed_size = chunk.uncompressed_size
        index.chunk_start_offset, index.chunk_length = moved[index.chunk_start_offset]
        offsets = index.message_index_offsets.items()
        index.message_index_offsets = {channel: moved[offset][0] for channel, offset in offsets}
    else:
        index.offset, index.length = moved[index.offset]
    return _built(index)[_HEAD.size :]


def _built(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _changed_chunk(chunk: Chunk, rng: np.random.Generator) -> Chunk:
    """A chunk with a message changed, or its bytes, or one that unpacks to a gigabyte."""
    if rng.random() < 0.03:
        packed, crc = _bomb()
        return replace(
            chunk,
            compression="zstd",
            data=packed,
            uncompressed_size=int(rng.choice([BOMB_BYTES, 1000])),
            uncompressed_crc=crc,
        )
    data = _unpacked(chunk)
    if rng.random() < 0.3:
        data = of_bytes(data, rng)
    else:
        records = list(_records(data, 0))
        chosen = int(rng.integers(len(records)))
        _, opcode, content = records[chosen]
        kept = _MESSAGE_HEAD_BYTES if opcode == Opcode.MESSAGE and rng.random() < 0.8 else 0
        records[chosen] = 0, opcode, content[:kept] + of_bytes(content[kept:], rng)
        data = b"".join(_HEAD.pack(kind, len(content)) + content for _, kind, content in records)
    return replace(
        chunk,
        data=_packed(data, chunk.compression),
        uncompressed_size=len(data),
        uncompressed_crc=zlib.crc32(data),
    )


def _unpacked(chunk: Chunk) -> bytes:
    if chunk.compression == "zstd":
        return zstandard.decompress(chunk.data)
    return lz4.frame.decompress(chunk.data) if chunk.compression == "lz4" else chunk.data


def _packed(data: bytes, compression: str) -> bytes:
    if compression == "zstd":
        return zstandard.compress(data)
    return lz4.frame.compress(data) if compression == "lz4" else data


@cache
def _bomb() -> tuple[bytes, int]:
    """A gigabyte of zeros, compressed, and its checksum."""
    packer, zeros = zstandard.ZstdCompressor(1).compressobj(BOMB_BYTES), bytes(2**20)
    packed, crc = b"", 0
    for _ in range(BOMB_BYTES // 2**20):
        packed += packer.compress(zeros)
        crc = zlib.crc32(zeros, crc)
    return packed + packer.flush(), crc


def _changed_metadata(content: bytes, rng: np.random.Generator) -> bytes:
    """Metadata with a value changed; where it carries our own checksum, that is made right."""
    record = Metadata.read(ReadDataStream(io.BytesIO(content)))
    values = dict(record.metadata)
    key = str(rng.choice(sorted(values)))
    values[key] = of_words(values[key].encode(), rng).decode(errors="replace")
    if CHECKSUM in values and key != CHECKSUM:
        values[CHECKSUM] = checksum(values)
    return _built(replace(record, metadata=values))[_HEAD.size :]
