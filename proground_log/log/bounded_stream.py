"""A file that MCAP's library may read: no length in it, and no compression, makes it ask for more
memory than the file can be worth.
"""

from __future__ import annotations

import os
from typing import BinaryIO

import zstandard
from mcap.exceptions import McapError

LARGEST_CHUNK_BYTES = 2**28
"""Unpacked; ours close once they hold 2 MiB."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_LZ4_MAGIC = b"\x04\x22\x4d\x18"


class BoundedStream:
    """Reads as the stream does, but never asks it for more bytes than it has left.

    The library takes each chunk out with one read and unpacks it to whatever size it announces;
    one that announces too much, or nothing, raises an McapError instead.

    Args:
        stream: the file, anywhere in it.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._at = stream, stream.tell()
        self._size = stream.seek(0, os.SEEK_END)
        stream.seek(self._at)

    def read(self, count: int = -1) -> bytes:
        """The next bytes, as many as there are, `count` at most."""
        left = max(0, self._size - self._at)
        data = self._stream.read(left if count < 0 else min(count, left))
        self._at += len(data)
        if data.startswith(_LZ4_MAGIC) or (data.startswith(_ZSTD_MAGIC) and _is_bomb(data)):
            raise McapError("a chunk does not say how much it unpacks to, or says too much")
        return data

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to another place in the file; returns where that is."""
        try:
            self._at = self._stream.seek(offset, whence)
        except (OSError, ValueError) as error:
            raise McapError(f"there is no byte {offset}") from error
        return self._at

    def seekable(self) -> bool:
        """Whether `seek` works."""
        return True

    def tell(self) -> int:
        """The place in the file."""
        return self._at


def _is_bomb(data: bytes) -> bool:
    try:
        return not 0 <= zstandard.frame_content_size(data) <= LARGEST_CHUNK_BYTES
    except zstandard.ZstdError:
        return False  # Of no use to the decompressor either.
