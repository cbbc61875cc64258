"""Figures of what the neural mapper remembers: groups of its `counts`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BufferStatistics:
    """The replay buffer at one moment.

    Args:
        samples, capacity: samples held, and the cap.
        keyframes: keyframes of which at least one sample is left.
        places: occupied cells, the unit of the buffer's fairness.
        water_level: most samples that any place holds.
        size_bytes: memory the samples take.
    """

    samples: int
    capacity: int
    keyframes: int
    places: int
    water_level: int
    size_bytes: int


@dataclass(frozen=True)
class SemanticStatistics:
    """The memory of meaning at one moment.

    Args:
        samples, capacity: rays that hit a region, and the cap.
        background: rays that hit none.
        regions: regions whose embedding is held.
        labels: rays by prompt.
        levels: rays by pyramid level, [3].
        inserted, evicted: rays that came in since the start of the replay, and had to go.
        size_bytes: memory all of it takes.
    """

    samples: int
    capacity: int
    background: int
    regions: int
    labels: dict[str, int]
    levels: list[int]
    inserted: int
    evicted: int
    size_bytes: int
