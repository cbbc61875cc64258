"""Pausing a replay at the terminal, to look at what it has so far."""

from __future__ import annotations

import sys

from pglog.common import err


class TerminalPause:
    """Pauses after the frames that the user named, and asks what to do.

    Args:
        frames: numbers in the log.
    """

    def __init__(self, frames: tuple[int, ...]) -> None:
        self._frames = frozenset(frames)
        self._is_stepping = False

    def wants(self, frame: int) -> bool:
        """Whether to pause after this frame."""
        return self._is_stepping or frame in self._frames

    def go_on(self, frame: int) -> bool:
        """Ask until the answer is one; where nobody can answer, stop."""
        answer = None
        while answer not in ("", "n", "q"):
            err.print(f"paused after frame {frame}: Enter goes on, n pauses at the next, q stops")
            line = sys.stdin.readline()
            answer = line.strip().lower() if line else "q"
        self._is_stepping = answer == "n"
        return answer != "q"
