"""What ROS's transport `compressedDepth` does to a depth image, undone.

A CompressedImage of it carries 12 bytes (i32 kind of coding, f32 a, f32 b), then a PNG of 16 bits
or RVL: millimetres for 16UC1; for 32FC1 the number a / depth_m + b, 0 where nothing was measured.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np

from proground_log.encoded_image import PNG_START, png_is_whole, png_size
from proground_log.errors import ProgroundError

DAMAGED = "record the bag again, or leave this topic out"
_HEADER = struct.Struct("<iff")
_SIZE = struct.Struct("<II")
_PLACES = 12
"""Digits of three bits: enough for any number of pixels."""


def decode_compressed_depth(
    data: bytes, image_format: str, size: tuple[int, int], *, where: object
) -> np.ndarray:
    """The depth image [H, W]: uint16 in millimetres, or float32 in metres; 0 = not measured.

    Args:
        data: the message's bytes.
        image_format: the message's format, such as "16UC1; compressedDepth png".
        size: width and height that the image has to have.
        where: the topic, for messages.

    Raises:
        ProgroundError: the image is damaged, of another size or of an unknown coding.
    """
    encoding, _, coding = image_format.partition(";")
    if len(data) < _HEADER.size:
        raise ProgroundError("the depth image is cut short", where=where, todo=DAMAGED)
    _, a, b = _HEADER.unpack_from(data)
    content = data[_HEADER.size :]
    if coding.split() == ["compressedDepth", "rvl"]:
        numbers = decode_rvl(content, size, where=where)
    elif coding.split() in ([], ["compressedDepth"], ["compressedDepth", "png"]):
        numbers = decode_depth_png(content, size, where=where)
    else:
        raise _unknown(image_format, where)
    if encoding.strip() in ("16UC1", "mono16"):
        return numbers
    if encoding.strip() != "32FC1":
        raise _unknown(image_format, where)
    with np.errstate(all="ignore"):
        depth_m = np.float32(a) / (numbers.astype(np.float32) - np.float32(b))
    return np.where((numbers > 0) & np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(0))


def _unknown(image_format: str, where: object) -> ProgroundError:
    return ProgroundError(
        f"depth of the format {image_format!r} is not known",
        where=where,
        todo="republish it as a raw image (`ros2 run image_transport republish`) and record that",
    )


def is_depth_png(data: bytes) -> bool:
    """Whether the bytes begin a PNG of 16 bits and one channel."""
    return data.startswith(PNG_START) and data[24:26] == b"\x10\x00"


def decode_depth_png(data: bytes, size: tuple[int, int], *, where: object) -> np.ndarray:
    """The numbers of a 16-bit PNG, uint16 [H, W]; its size is checked before it is decoded."""
    if not is_depth_png(data) or not png_is_whole(data):
        what = "the depth image is no whole PNG of 16 bits and one channel"
        raise ProgroundError(what, where=where, todo=DAMAGED)
    _require_size(png_size(data), size, where)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ProgroundError("the depth image cannot be decoded", where=where, todo=DAMAGED)
    return np.asarray(image, dtype=np.uint16)


def decode_rvl(data: bytes, size: tuple[int, int], *, where: object) -> np.ndarray:
    """The numbers of an RVL image, uint16 [H, W] (Wilson, "Fast Lossless Depth Image Compression").

    Width and height come first, then runs: how many zeros, how many others, and of each of these
    the difference to the one before. All numbers are of hexadecimal digits, the lowest first, in
    words of 32 bits: three bits and one that says whether more follow.
    """
    if len(data) < _SIZE.size:
        raise ProgroundError("the depth image is cut short", where=where, todo=DAMAGED)
    _require_size(_SIZE.unpack_from(data), size, where)
    count = size[0] * size[1]
    words = np.frombuffer(data, "<u4", (len(data) - _SIZE.size) // 4, _SIZE.size)
    digits = (
        (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 15).astype(np.int64).ravel()
    )
    values = _numbers(digits)
    measured = np.zeros(count, dtype=bool)
    changes, at, pixel = [], 0, 0
    while pixel < count and at + 1 < len(values):
        zeros, others = int(values[at]), int(values[at + 1])
        pixel += zeros + others
        at += 2 + others
        if pixel > count or at > len(values):
            break
        measured[pixel - others : pixel] = True
        changes.append(values[at - others : at])
    if pixel != count or at > len(values):
        raise ProgroundError("the depth image is damaged", where=where, todo=DAMAGED)
    coded = np.concatenate([*changes, np.zeros(0, dtype=np.int64)])
    pixels = np.zeros(count, dtype=np.uint16)
    # The lowest bit is the sign; the rest counts towards it.
    pixels[measured] = np.cumsum((coded >> 1) ^ -(coded & 1)).astype(np.uint16)
    return pixels.reshape(size[1], size[0])


def _numbers(digits: np.ndarray) -> np.ndarray:
    """Gather digits into numbers, int64; a digit under 8 is the last of its number."""
    last = np.flatnonzero(digits < 8)
    if not len(last):
        return np.zeros(0, dtype=np.int64)
    first = np.concatenate([[0], last[:-1] + 1])
    digits = digits[: last[-1] + 1]
    place = np.arange(len(digits)) - np.repeat(first, last - first + 1)
    # Digits further up are there in damaged images only, and would not fit.
    parts = np.where(place < _PLACES, (digits & 7) << 3 * np.minimum(place, _PLACES), 0)
    return np.add.reduceat(parts, first)


def _require_size(found: tuple[int, ...], size: tuple[int, int], where: object) -> None:
    if tuple(found) != size:
        raise ProgroundError(
            f"the depth image is {found[0]}x{found[1]}, its camera {size[0]}x{size[1]}",
            where=where,
            todo="name the right depth_info_topic, or pass the calibration",
        )
