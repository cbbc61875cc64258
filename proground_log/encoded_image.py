"""Encoded images, judged by their bytes: decoders fill up what is cut short without a word."""

from __future__ import annotations

import struct

JPEG_START, JPEG_SCAN, JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
PNG_START = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
"""The signature, and the beginning of the first chunk, which has the size."""
_PNG_SIZE = struct.Struct(">II")
_PNG_CHUNK = struct.Struct(">I4s")
_PNG_FIRST_CHUNK, _PNG_CHECKSUM_BYTES = 8, 4
_PNG_END_CHECKSUM = b"\xaeB`\x82"
"""Of the chunk that ends a file, and so its last bytes; it has no content."""


def is_whole(data: bytes, image_format: str) -> bool:
    """Whether a "jpeg" or "png" has its end; whatever follows the end (padding) does no harm."""
    return _jpeg_is_whole(data) if image_format == "jpeg" else png_is_whole(data)


def png_is_whole(data: bytes) -> bool:
    """Whether bytes are a PNG file whose chunks lead to its end, whatever may follow that.

    OpenCV makes room for as many bytes as a chunk says it has, up to two gigabytes.
    """
    at = _PNG_FIRST_CHUNK if data.startswith(PNG_START) else len(data)
    while at + _PNG_CHUNK.size <= len(data):
        length, kind = _PNG_CHUNK.unpack_from(data, at)
        at += _PNG_CHUNK.size + length + _PNG_CHECKSUM_BYTES
        if kind == b"IEND":
            return data[at - _PNG_CHECKSUM_BYTES : at] == _PNG_END_CHECKSUM
    return False


def png_size(data: bytes) -> tuple[int, int]:
    """Width and height by the header of a whole PNG file."""
    width, height = _PNG_SIZE.unpack_from(data, len(PNG_START))
    return width, height


def _jpeg_is_whole(data: bytes) -> bool:
    """Whether an end marker follows the first scan: a thumbnail, with its own, comes before."""
    at = len(JPEG_START)
    while data[at : at + 1] == b"\xff":
        if data[at : at + 2] == JPEG_SCAN:
            return data.rfind(JPEG_END) > at
        is_fill = data[at + 1 : at + 2] == b"\xff"
        at += 1 if is_fill else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return False
