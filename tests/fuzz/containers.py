"""Changes within what a checksum, a compression or a length encloses, which is then made right.

Blind changes to such files end at the checksum; these reach the code behind it. Here are also
bombs: a few kilobytes that unpack to gigabytes.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import gettempdir
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import lz4.block
import numpy as np

from tests.fuzz.mutations import of_bytes, of_words

BOMB_BYTES = 2**31
PNG_START = b"\x89PNG\r\n\x1a\n"
OUTSIDE = Path(gettempdir()) / "pglog-fuzz-escaped"
"""Where a member with this absolute name would be written."""
_PNG_CHUNK = struct.Struct(">I4s")


@cache
def deflated_bomb() -> bytes:
    """Raw deflate of two gigabytes of zeros."""
    packer = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    # After a full flush nothing depends on what was before: the piece can be repeated.
    piece = packer.compress(bytes(2**20)) + packer.flush(zlib.Z_FULL_FLUSH)
    return piece * (BOMB_BYTES // 2**20) + packer.flush()


def of_png(data: bytes, rng: np.random.Generator) -> bytes:
    """A PNG with a chunk changed, its checksum right; of pixels, what they unpack to."""
    chunks = list(_png_chunks(data))
    at = int(rng.integers(len(chunks)))
    kind, content = chunks[at]
    if kind == b"IHDR" and rng.random() < 0.5:
        sides = rng.choice([0, 1, 20_000, 40_000, 2**31 - 1, 2**32 - 1], 2)
        content = struct.pack(">II", *sides.tolist()) + content[8:]
    elif kind == b"IDAT" and rng.random() < 0.5:
        content = zlib.compress(of_bytes(zlib.decompress(content), rng))
    else:
        content = of_bytes(content, rng)
    chunks[at] = kind, content
    return PNG_START + b"".join(
        _PNG_CHUNK.pack(len(content), kind)
        + content
        + zlib.crc32(kind + content).to_bytes(4, "big")
        for kind, content in chunks
    )


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(PNG_START)
    while at < len(data):
        length, kind = _PNG_CHUNK.unpack_from(data, at)
        at += _PNG_CHUNK.size
        yield kind, data[at : at + length]
        at += length + 4


def of_zip(data: bytes, rng: np.random.Generator) -> bytes:
    """A zip written anew with a member changed, twice there, under a hostile name, or a bomb."""
    with ZipFile(io.BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    at = int(rng.integers(len(members)))
    name, content = members[at]
    match int(rng.integers(6)):
        case 0:
            members.append((name, of_bytes(content, rng)))
        case 1:
            members[at] = _hostile(name, rng), content
        case 2:
            members.append((_hostile(name, rng), content))
        case 3:
            return _zipped_bomb(members, at, claimed=int(rng.choice([BOMB_BYTES, len(content)])))
        case _:
            change = of_words if content.startswith(b"{") else of_bytes
            members[at] = name, change(content, rng)
    return _zipped(members, ZIP_DEFLATED if rng.random() < 0.5 else ZIP_STORED)


def _hostile(name: str, rng: np.random.Generator) -> str:
    names = (
        *(f"{OUTSIDE}", f"/{name}", f"../{name}", f"a/../../{name}", f"C:\\{name}"),
        *(f"..\\{name}", f"{name}\0", "", ".", "a" * 60_000, "\udcff".encode("utf-8", "replace")),
    )
    return str(names[rng.integers(len(names))])


def _zipped(members: list[tuple[str, bytes]], compression: int) -> bytes:
    target = io.BytesIO()
    with ZipFile(target, "w", compression) as archive:
        for name, content in members:
            info = ZipInfo("stand-in")
            # The constructor would end the name at a NUL.
            info.filename, info.compress_type = name, compression
            archive.writestr(info, content)
    return target.getvalue()


def _zipped_bomb(members: list[tuple[str, bytes]], at: int, *, claimed: int) -> bytes:
    """One member unpacks to gigabytes, whether its header says so or not."""
    name, _ = members[at]
    bomb = deflated_bomb()
    data = bytearray(_zipped([*members[:at], *members[at + 1 :], (name, bomb)], ZIP_STORED))
    local, central = data.rfind(b"PK\x03\x04", 0, data.rfind(bomb[:64])), data.rfind(b"PK\x01\x02")
    for header, method, size in ((local, 8, 22), (central, 10, 24)):
        struct.pack_into("<H", data, header + method, ZIP_DEFLATED)
        struct.pack_into("<I", data, header + size, claimed)
    return bytes(data)


def of_sens(data: bytes, rng: np.random.Generator) -> bytes:
    """A .sens stream with the images of a frame changed, their lengths and compression right."""
    name_length = int.from_bytes(data[4:12], "little")
    at = 12 + name_length + 4 * 64 + 2 * 4 + 4 * 4 + 4 + 8
    count = int.from_bytes(data[at - 8 : at], "little")
    chosen, changed = int(rng.integers(count)), [data[:at]]
    for number in range(count):
        color_bytes, depth_bytes = struct.unpack_from("<QQ", data, at + 80)
        head, at = data[at : at + 80], at + 96
        color, depth = data[at : at + color_bytes], data[at + color_bytes :][:depth_bytes]
        at += color_bytes + depth_bytes
        if number == chosen:
            color, depth = _changed_images(color, depth, rng)
        changed.append(head + struct.pack("<QQ", len(color), len(depth)) + color + depth)
    return b"".join([*changed, data[at:]])


def _changed_images(color: bytes, depth: bytes, rng: np.random.Generator) -> tuple[bytes, bytes]:
    match int(rng.integers(4)):
        case 0:
            return of_bytes(color, rng), depth
        case 1 if depth.startswith(b"\x78"):
            return color, zlib.compress(of_bytes(zlib.decompress(depth), rng))
        case 2 if depth.startswith(b"\x78"):
            return color, zlib.compress(bytes(2**26), 9)
        case _:
            return color, of_bytes(depth, rng)


def of_records(data: bytes, rng: np.random.Generator) -> bytes:
    """ScanNet++'s depth.bin with a record changed, its length right."""
    records, at = [], 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "little")
        records.append(data[at + 4 : at + 4 + length])
        at += 4 + length
    number = int(rng.integers(len(records)))
    match int(rng.integers(4)):
        case 0:
            records[number] = lz4.block.compress(bytes(2**26), store_size=False)
        case 1:
            records[number] = deflated_bomb()[: 2**16]
        case _:
            records[number] = of_bytes(records[number], rng)
    return b"".join(len(record).to_bytes(4, "little") + record for record in records)
