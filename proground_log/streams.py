"""Random numbers that depend on what they are for, and on nothing else.

One Philox stream a purpose and moment, never a generator that is shared: an extra draw for one
purpose cannot shift another's, and a replay that is resumed draws what it would have drawn.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, purpose: str, *moment: int) -> np.random.Generator:
    """The generator of one purpose ("rays", "jitter", ...) at one moment (frame, iteration, ...).

    >>> again = stream(0, "rays", 3, 1).random(4) == stream(0, "rays", 3, 1).random(4)
    >>> again.tolist()
    [True, True, True, True]
    """
    name = "/".join([str(seed), purpose, *map(str, moment)])
    key = hashlib.blake2b(name.encode(), digest_size=16).digest()
    return np.random.Generator(np.random.Philox(key=np.frombuffer(key, dtype="<u8")))
