"""LZFSE, Apple's compression, into a buffer of known size.

The package's own function doubles its buffer until the data fit, and so knows no bound. The C
library that it carries has one: `lzfse_decode_buffer` fills what it is given and stops
(https://github.com/lzfse/lzfse, lzfse.h).
"""

from __future__ import annotations

import ctypes
from functools import cache
from importlib.util import find_spec
from typing import Any

from proground_log.errors import ProgroundError

INSTALL = "pip install 'proground-log[phone]'"


def decompress(data: bytes, size: int, *, where: object) -> bytes:
    """The `size` bytes that were compressed; never more memory than for these.

    Raises:
        ProgroundError: the data are broken or hold another number of bytes, or the package
            `lzfse` is not installed.
    """
    # One byte more than wanted, to see what is too long.
    target = (ctypes.c_uint8 * (size + 1))()
    written = _decoder()(target, size + 1, data, len(data), None)
    if written != size:
        raise ProgroundError(
            f"does not hold {size} bytes in LZFSE",
            where=where,
            todo="export the recording again, or leave the frame out",
        )
    return bytes(memoryview(target)[:size])


@cache
def _decoder() -> Any:
    """The C function: (target, its size, source, its size, no scratch space) -> bytes written."""
    spec = find_spec("lzfse")
    try:
        library = ctypes.CDLL(spec.origin if spec and spec.origin else "lzfse")
        decode = library.lzfse_decode_buffer
    except (OSError, AttributeError) as error:
        raise ProgroundError(
            "LZFSE needs the package lzfse, for Linux or macOS", where="lzfse", todo=INSTALL
        ) from error
    decode.restype = ctypes.c_size_t
    decode.argtypes = [
        ctypes.c_void_p,
        ctypes.c_size_t,
        ctypes.c_char_p,
        ctypes.c_size_t,
        ctypes.c_void_p,
    ]
    return decode
