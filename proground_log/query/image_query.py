"""A picture in a text's place: its embedding, and a bank's that shows nothing in particular."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.frame import evenly
from proground_log.log.reader import LogReader
from proground_log.perception.onnx.image_encoder import OnnxImageEncoder

BANK_FRAMES, BANK_SIDE = 12, 2
"""The bank behind an image query: so many frames, each cut into a grid of that side."""


@dataclass(frozen=True)
class ImageQuery:
    """A picture of what to look for, and the encoder (.onnx) that puts it in a text's place."""

    image: Path
    encoder: Path


def embed_image(query: ImageQuery, log: LogReader) -> np.ndarray:
    """Embeddings of the image and of its bank, [1 + B, 512]."""
    image, encoder = _read_image(query.image), OnnxImageEncoder(query.encoder)
    return np.stack([encoder.embed(picture) for picture in (image, *background_crops(log))])


def _read_image(path: Path) -> np.ndarray:
    """An image file, uint8 [H, W, 3] RGB, the way up that its camera noted."""
    try:
        with Image.open(require_file(path)) as image:
            return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        raise ProgroundError(
            f"cannot be read as an image ({error})", where=path, todo="give a JPEG or PNG file"
        ) from error


def background_crops(reader: LogReader) -> Iterator[np.ndarray]:
    """Pieces of a log's colour images, uint8 [h, w, 3] RGB, that show nothing in particular.

    Frames evenly spaced over the log, each cut into a grid: 48 pieces, fewer of a short log.
    """
    for sensor in reader.frames(evenly(len(reader), BANK_FRAMES)):
        for band in np.array_split(sensor.decode_color(), BANK_SIDE, axis=0):
            yield from np.array_split(band, BANK_SIDE, axis=1)
