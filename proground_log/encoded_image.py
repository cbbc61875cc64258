"""Encoded images, judged by their bytes: decoders fill up what is cut short without a word."""

from __future__ import annotations

JPEG_START, JPEG_SCAN, JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"


def is_whole(data: bytes, image_format: str) -> bool:
    """Whether a "jpeg" or "png" has its end; whatever follows the end (padding) does no harm."""
    return _jpeg_is_whole(data) if image_format == "jpeg" else png_is_whole(data)


def png_is_whole(data: bytes) -> bool:
    """Whether a PNG image has its end marker."""
    return PNG_END in data[-4096:] or PNG_END in data


def _jpeg_is_whole(data: bytes) -> bool:
    """Whether an end marker follows the first scan: a thumbnail, with its own, comes before."""
    at = len(JPEG_START)
    while data[at : at + 1] == b"\xff":
        if data[at : at + 2] == JPEG_SCAN:
            return data.rfind(JPEG_END) > at
        is_fill = data[at + 1 : at + 2] == b"\xff"
        at += 1 if is_fill else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return False
