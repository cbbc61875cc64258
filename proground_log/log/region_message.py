"""The message of a frame's regions: to and from what it means."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from proground_log.encoded_image import png_is_whole
from proground_log.errors import ProgroundError
from proground_log.log import topics
from proground_log.log.cdr import decoder
from proground_log.log.messages import DEFINITIONS, REGIONS_TYPE, encoder, header
from proground_log.regions import EMBEDDING_WIDTH, LEVELS, Regions

_encode = encoder(REGIONS_TYPE)
_decode = decoder(REGIONS_TYPE, DEFINITIONS[REGIONS_TYPE])
_FASTEST = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def encode_regions(regions: Regions, stamp_ns: int) -> bytes:
    """Regions as CDR bytes, the same for equal regions.

    Args:
        regions: of one colour image.
        stamp_ns: the image's own time.
    """
    height, width = regions.owner.shape
    _, owner = cv2.imencode(".png", regions.owner, _FASTEST)
    return _encode(
        SimpleNamespace(
            header=header(stamp_ns, topics.COLOR_FRAME),
            boxes=regions.boxes.ravel().tolist(),
            levels=regions.levels.tobytes(),
            prompts=regions.relevance.shape[1],
            relevance=regions.relevance.ravel().tolist(),
            embeddings=regions.embeddings.astype("<f2").tobytes(),
            is_box=regions.is_box.tolist(),
            height=height,
            width=width,
            owner=owner.tobytes(),
        )
    )


def decode_regions(data: bytes, *, where: object) -> Regions:
    """The regions in CDR bytes; raises a ProgroundError where they are damaged."""
    try:
        message = _decode(data)
    except (struct.error, ValueError, IndexError, MemoryError) as error:
        raise _error("the message cannot be decoded", where) from error
    return regions_of(message, where=where)


def regions_of(message: Any, *, where: object) -> Regions:
    """The regions in a decoded message; raises a ProgroundError unless its parts fit together.

    Whether boxes, relevance and embeddings make sense is left to `pglog check`.
    """
    levels = np.frombuffer(message.levels, np.uint8)
    count, prompts = len(levels), message.prompts
    sizes = {
        "boxes": (len(message.boxes), 4 * count),
        "relevance": (len(message.relevance), prompts * count),
        "embeddings": (len(message.embeddings), 2 * EMBEDDING_WIDTH * count),
        "is_box": (len(message.is_box), count),
    }
    for name, (found, expected) in sizes.items():
        if found != expected:
            what = f"{count} regions and {prompts} prompts have {found} values of {name}"
            raise _error(f"{what}, not {expected}", where)
    if (levels >= LEVELS).any():
        raise _error(f"a region has the level {levels.max()}, there are {LEVELS}", where)
    encoded = np.frombuffer(message.owner, np.uint8)
    is_whole = png_is_whole(message.owner)
    owner = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if is_whole else None
    if owner is None or owner.dtype != np.uint16:
        raise _error("its image of owners is no whole 16-bit PNG", where)
    if owner.shape != (message.height, message.width):
        size = f"{message.width}x{message.height}"
        raise _error(f"its image of owners is {owner.shape[1]}x{owner.shape[0]}, not {size}", where)
    if owner.max(initial=0) > count:
        raise _error(f"a pixel belongs to region {owner.max() - 1}, there are {count}", where)
    return Regions(
        boxes=np.array(message.boxes, np.float32).reshape(count, 4),
        levels=levels,
        relevance=np.array(message.relevance, np.float32).reshape(count, prompts),
        embeddings=np.frombuffer(message.embeddings, "<f2").reshape(count, EMBEDDING_WIDTH),
        owner=owner,
        is_box=np.array(message.is_box, bool),
    )


def _error(what: str, where: object) -> ProgroundError:
    return ProgroundError(what, where=where, todo="run `pglog perceive` again")
