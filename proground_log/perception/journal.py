"""A file of records that is only ever appended to, so that a crash loses the last one at most."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from proground_log.files import disk_errors

_MAGIC = b"pglog journal 1\n"
_RECORD = struct.Struct("<QI")
"""Before each record: its length and its CRC-32."""


class Journal:
    """Records of one piece of work; made by `open_journal`.

    Args:
        stream: the file, open for reading and writing.
        key: 32 bytes that tell this work from any other. The whole records that an earlier
            journal of the same key left are kept; anything else is cut off.
    """

    def __init__(self, stream: BinaryIO, key: bytes) -> None:
        self._stream = stream
        self._places: list[tuple[int, int]] = []
        start = _MAGIC + key
        if stream.read(len(start)) != start:
            stream.seek(0)
            stream.truncate()
            stream.write(start)
        self._end = len(start)
        while (length := self._whole_record()) is not None:
            self._places.append((self._end + _RECORD.size, length))
            self._end += _RECORD.size + length
        stream.truncate(self._end)

    def _whole_record(self) -> int | None:
        """The length of the record that begins at the end so far; None if it is torn or none."""
        self._stream.seek(self._end)
        header = self._stream.read(_RECORD.size)
        if len(header) < _RECORD.size:
            return None
        length, checksum = _RECORD.unpack(header)
        size = self._stream.seek(0, 2) - self._end - _RECORD.size
        self._stream.seek(self._end + _RECORD.size)
        # Asked first, for a torn length may be larger than memory.
        is_whole = length <= size and zlib.crc32(self._stream.read(length)) == checksum
        return length if is_whole else None

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> bytes:
        """The record of this number, from 0."""
        at, length = self._places[number]
        self._stream.seek(at)
        return self._stream.read(length)

    def append(self, data: bytes) -> None:
        """Add a record and hand it to the operating system, where a killed process leaves it."""
        self._stream.seek(self._end)
        self._stream.write(_RECORD.pack(len(data), zlib.crc32(data)) + data)
        self._stream.flush()
        self._places.append((self._end + _RECORD.size, len(data)))
        self._end += _RECORD.size + len(data)


@contextmanager
def open_journal(path: Path, key: bytes) -> Iterator[Journal]:
    """Go on with the journal of this key, or begin one.

    It is removed when the work is done; an interruption leaves it, unless it is empty.
    """
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        with path.open("r+b") as stream:
            journal = Journal(stream, key)
            try:
                yield journal
            except BaseException:
                if not len(journal):
                    path.unlink()
                raise
    path.unlink()
