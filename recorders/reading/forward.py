"""Images in a stream that can only be read from its start, given out by number to any thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from threading import Lock

import numpy as np

from proground_log.errors import ProgroundError

READERS = 3
"""How many places in the stream are kept: threads ask for frames a little out of order, and one
that falls behind must not send the others back to the start."""

Images = Iterator[Callable[[], np.ndarray]]
"""The stream's images in order; each can be decoded until the next is asked for."""


@dataclass(eq=False)
class _Reader:
    images: Images
    following: int = 0


class ForwardImages:
    """Exact random access: what is asked for is read up to, never sought.

    Args:
        start: opens the stream anew.
        where: the file, for messages.
    """

    def __init__(self, start: Callable[[], Images], where: object) -> None:
        self._start, self._where = start, where
        self._lock = Lock()
        self._readers: list[_Reader] = []

    def at(self, number: int) -> np.ndarray:
        """Image `number`, counted from 0; raises a ProgroundError where the stream ends before."""
        with self._lock:
            reader = self._taken_before(number)
            for image in reader.images:
                reader.following += 1
                if reader.following > number:
                    self._readers.append(reader)
                    return image()
        raise ProgroundError(
            f"ends after {reader.following} frames, before frame {number}",
            where=self._where,
            todo="copy the file from the data set again, or record fewer frames (--stop)",
        )

    def _taken_before(self, number: int) -> _Reader:
        """The nearest reader that has not passed the image yet, else a new one; off the list."""
        self._readers.sort(key=lambda reader: reader.following)
        ready = [reader for reader in self._readers if reader.following <= number]
        if ready:
            self._readers.remove(ready[-1])
            return ready[-1]
        # The readers furthest on serve the frames to come; the first is of the least use.
        del self._readers[: len(self._readers) - READERS + 1]
        return _Reader(self._start())
