"""Image files: colour kept as bytes, depth and labels decoded; truncated files are refused."""

from __future__ import annotations

import io
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from proground_log.camera import Camera
from proground_log.encoded_image import is_whole, png_is_whole, png_size
from proground_log.errors import ProgroundError
from proground_log.files import require_file

COPY_AGAIN = "copy the file from the data set again"


@dataclass(frozen=True)
class EncodedImage:
    """An image file, not decoded.

    Args:
        data: the file's bytes.
        format: "jpeg" or "png".
        width, height: size in pixels, from the header.
    """

    data: bytes
    format: str
    width: int
    height: int


def numbered_files(folder: Path, pattern: str) -> dict[int, Path]:
    """The files of a folder whose whole name matches, by the number in the pattern's group 1.

    Args:
        folder: where to look, not recursively.
        pattern: a regular expression with the number as its first group.

    Returns:
        number -> path, ascending as numbers; empty where nothing matches.

    Raises:
        ProgroundError: there is no such folder, or two files have the same number.
    """
    if not folder.is_dir():
        raise ProgroundError("no such folder", where=folder, todo="check the path")
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        match = re.fullmatch(pattern, path.name)
        if match is None:
            continue
        number = int(match[1])
        if number in found:
            raise ProgroundError(
                f"has the same number as {found[number].name}",
                where=path,
                todo="remove the one that does not belong to the recording",
            )
        found[number] = path
    return dict(sorted(found.items()))


def read_encoded(path: Path) -> EncodedImage:
    """Read a JPEG or PNG file without decoding it; errors as `encoded_image`."""
    return encoded_image(require_file(path).read_bytes(), where=path)


def encoded_image(data: bytes, *, where: object) -> EncodedImage:
    """The bytes of a JPEG or PNG file, not decoded, with what its header says.

    Raises:
        ProgroundError: the bytes are neither format, or are cut short.
    """
    try:
        with Image.open(io.BytesIO(data)) as image:
            kind, (width, height) = image.format, image.size
    except (Image.DecompressionBombError, OSError, SyntaxError, ValueError, struct.error) as error:
        raise ProgroundError("is not a readable image", where=where, todo=COPY_AGAIN) from error
    if kind not in ("JPEG", "PNG"):
        raise ProgroundError(
            f"is a {kind} image", where=where, todo="convert the images to JPEG or PNG"
        )
    if not is_whole(data, kind.lower()):
        raise ProgroundError(f"the {kind} image is cut short", where=where, todo=COPY_AGAIN)
    return EncodedImage(data, kind.lower(), width, height)


def encoded_png(pixels: np.ndarray) -> bytes:
    """A PNG of pixels uint8 [H, W, 3] RGB: nothing is lost where a source has no encoded image."""
    _, png = cv2.imencode(
        ".png", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 1]
    )
    return bytes(png.tobytes())


def read_color(path: Path, camera: Camera) -> EncodedImage:
    """Read a colour file without decoding it; raise a ProgroundError unless it fits the camera."""
    image = read_encoded(path)
    require_size(path, (image.width, image.height), camera)
    return image


def read_depth(path: Path, camera: Camera) -> np.ndarray:
    """Decode a depth PNG to uint16 [H, W], in the file's own unit.

    Raises:
        ProgroundError: the file is missing, cut short, broken, not 16-bit with one channel, or
            of another size than the camera's.
    """
    depth = _decode_png(path, camera)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        channels = 1 if depth.ndim == 2 else depth.shape[2]
        raise ProgroundError(
            f"is not a depth image: {8 * depth.dtype.itemsize} bits, {channels} channel(s)",
            where=path,
            todo="depth has to be a PNG of 16 bits and one channel",
        )
    return depth


def read_labels(path: Path, camera: Camera) -> np.ndarray:
    """Decode a class image (PNG, 8 or 16 bits, one channel) to uint16 [H, W].

    Raises:
        ProgroundError: as `read_depth`.
    """
    labels = _decode_png(path, camera)
    if labels.ndim != 2:
        raise ProgroundError(
            f"is not a class image: it has {labels.shape[2]} channels",
            where=path,
            todo="classes have to be a PNG of 8 or 16 bits and one channel",
        )
    return labels.astype(np.uint16)


def _decode_png(path: Path, camera: Camera) -> np.ndarray:
    """The pixels of a PNG, whose size is compared with the camera's before anything is decoded."""
    data = require_file(path).read_bytes()
    if not png_is_whole(data):
        raise ProgroundError(
            "is not a whole PNG image (no end marker)", where=path, todo=COPY_AGAIN
        )
    require_size(path, png_size(data), camera)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ProgroundError("the PNG image cannot be decoded", where=path, todo=COPY_AGAIN)
    return np.asarray(image)


def require_size(where: object, size: tuple[int, int], camera: Camera) -> None:
    """Raise a ProgroundError unless an image of this (width, height) fits the camera."""
    if size != (camera.width, camera.height):
        raise ProgroundError(
            f"is {size[0]}x{size[1]}, but the calibration is for {camera.width}x{camera.height}",
            where=where,
            todo="pass the calibration of these images, or remove the ones that do not belong",
        )
