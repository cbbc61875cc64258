"""Random numbers that depend on what they are for, and on nothing drawn before."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a stream of random numbers is drawn for; the numbers are part of the room's look."""

    COLORS = 1
    PLACEMENT = 2
    BOOKS = 3
    PATH = 4
    DEPTH_NOISE = 5
    COLOR_NOISE = 6


def stream(seed: int, purpose: Purpose, frame: int = 0) -> np.random.Generator:
    """The generator of one purpose (and frame) of the room with this seed, 0 <= seed < 2**64."""
    key = np.array([seed, (int(purpose) << 32) | frame], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))
