"""Images in NumPy's .npy files (versions 1 and 2): a header in words, then the bare numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.files import require_file

HEADER = re.compile(
    rb"\x93NUMPY(?:\x01\x00..|\x02\x00....)"
    rb"\{'descr': '([<>|](?:f[248]|[ui][1248]))', 'fortran_order': (True|False), "
    rb"'shape': \(([1-9]\d{0,8}), ([1-9]\d{0,8})(?:, 1)?\), \} *\n",
    re.DOTALL,
)
"""What `numpy.save` writes of an image.

NumPy's own reader takes any Python literal for a header: it gives shapes below 0, and raises
MemoryError or errors of `tokenize` where the literal is broken.
"""


def read_npy_image(path: Path) -> np.ndarray:
    """One number a pixel, float32 [H, W]; a last axis of length 1 is left out.

    Raises:
        ProgroundError: the file is missing or broken, or holds anything but an image of numbers.
    """
    data = require_file(path).read_bytes()
    match = HEADER.match(data)
    if match is None:
        raise ProgroundError(
            "is not an image in NumPy's format, one number a pixel",
            where=path,
            todo="save a depth image [H, W] with numpy.save",
        )
    kind, shape = np.dtype(match[1].decode()), (int(match[3]), int(match[4]))
    # The shape is only what the header says: reserve nothing before the file proves it.
    if shape[0] * shape[1] * kind.itemsize != len(data) - match.end():
        raise ProgroundError(
            f"has {len(data) - match.end()} bytes for {shape[1]}x{shape[0]} of {kind}",
            where=path,
            todo="copy the file from the data set again",
        )
    pixels = np.frombuffer(data, kind, offset=match.end())
    # A number that float32 cannot hold becomes infinite: it was no depth.
    with np.errstate(over="ignore", invalid="ignore"):
        columns_first = match[2] == b"True"
        return pixels.reshape(shape, order="F" if columns_first else "C").astype(np.float32)
