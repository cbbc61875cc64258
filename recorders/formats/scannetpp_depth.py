"""depth.bin of ScanNet++: the iPhone's depth stream, 256x192, in one of two codings.

Either each frame is a uint32 (little endian), the number of bytes that follow, and these, an LZ4
block of uint16 in millimetres or raw deflate of float32 in metres; or the whole file is one raw
deflate stream of float32 in metres. Nothing in the file says which.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import lz4.block  # type: ignore[import-untyped]
import numpy as np

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from recorders.reading.forward import ForwardImages, Images

WIDTH, HEIGHT = 256, 192
FLOAT_BYTES, UINT_BYTES = 4 * WIDTH * HEIGHT, 2 * WIDTH * HEIGHT
LARGEST_RECORD_BYTES = 2 * FLOAT_BYTES
"""What does not compress grows, but never to this."""
READ_BYTES = 2**18
REMEDY = "copy the file from the data set again"


@dataclass(frozen=True)
class DepthStream:
    """An opened depth.bin.

    Args:
        at: reads depth image `number` [192, 256], uint16 in millimetres or float32 in metres, 0
            where nothing was measured; may be called from any thread. Raises a ProgroundError.
        frames: how many there are; None where only reading the whole file would tell.
        is_cut: whether the file ends within a frame.
    """

    at: Callable[[int], np.ndarray]
    frames: int | None
    is_cut: bool = False


def open_depth(path: Path) -> DepthStream:
    """Find out the file's coding, and where its frames are if they have sizes.

    Raises:
        ProgroundError: the file is missing, or is in neither coding.
    """
    places, is_cut = _records(require_file(path))
    if places:
        try:
            _read_record(path, places, 0)
            return DepthStream(partial(_read_record, path, places), len(places), is_cut)
        except ProgroundError:
            pass  # The first bytes of a deflate stream can look like a size.
    try:
        next(_inflated(path))
    except (ProgroundError, StopIteration) as error:
        raise ProgroundError(
            "holds depth in neither coding of ScanNet++", where=path, todo=REMEDY
        ) from error
    # Decoded in passing, a frame at a time: unpacked, the file would fill tens of gigabytes.
    return DepthStream(ForwardImages(partial(_inflated, path), path).at, None)


def _records(path: Path) -> tuple[list[tuple[int, int]], bool]:
    """Where frames of the first coding are, (offset, bytes), and whether the last is cut off."""
    places: list[tuple[int, int]] = []
    with path.open("rb") as stream:
        end = stream.seek(0, os.SEEK_END)
        at = stream.seek(0)
        while at < end:
            size = int.from_bytes(stream.read(4), "little")
            if not 0 < size <= LARGEST_RECORD_BYTES or at + 4 + size > end:
                return places, True
            places.append((at + 4, size))
            at = stream.seek(at + 4 + size)
    return places, False


def _read_record(path: Path, places: list[tuple[int, int]], number: int) -> np.ndarray:
    """Decode one frame of the first coding: LZ4 if it can be, as the data set's tools do."""
    offset, size = places[number]
    with path.open("rb") as stream:
        stream.seek(offset)
        data = stream.read(size)
    try:
        pixels = lz4.block.decompress(data, uncompressed_size=UINT_BYTES)
        if len(pixels) == UINT_BYTES:
            return np.frombuffer(pixels, "<u2").reshape(HEIGHT, WIDTH).astype(np.uint16)
    except lz4.block.LZ4BlockError:
        pass
    inflate = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        pixels = inflate.decompress(data, FLOAT_BYTES + 1)
    except zlib.error:
        pixels = b""
    if len(pixels) != FLOAT_BYTES:
        raise ProgroundError(
            "the depth image cannot be decoded", where=f"{path}, frame {number}", todo=REMEDY
        )
    return _metres(pixels)


def _inflated(path: Path) -> Images:
    """The frames of the second coding, one after the other; holds no more than one."""
    for number, pixels in enumerate(_inflated_chunks(path)):
        if len(pixels) != FLOAT_BYTES:
            raise ProgroundError(
                "the depth stream is broken or cut off here",
                where=f"{path}, frame {number}",
                todo=REMEDY,
            )
        yield partial(_metres, pixels)


def _inflated_chunks(path: Path) -> Iterator[bytes]:
    """Unpacked bytes, a frame's at a time; the last is shorter where the stream breaks off."""
    inflate, pixels = zlib.decompressobj(-zlib.MAX_WBITS), b""
    with path.open("rb") as stream:
        packed = stream.read(READ_BYTES)
        while packed and not inflate.eof:
            try:
                pixels += inflate.decompress(packed, FLOAT_BYTES - len(pixels))
            except zlib.error:
                break
            if len(pixels) == FLOAT_BYTES:
                yield pixels
                pixels = b""
            packed = inflate.unconsumed_tail or stream.read(READ_BYTES)
    if pixels or not inflate.eof:
        yield pixels


def _metres(pixels: bytes) -> np.ndarray:
    depth = np.frombuffer(pixels, "<f4").reshape(HEIGHT, WIDTH).astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = 0
    return depth
