"""The objects of a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proground_log.query.boxes import OrientedBox
from proground_log.query.instances import Instance

LEAST_RELEVANCE = 0.1
"""An object's mean relevance: what wins with less, wins among prompts of which none fits."""


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a map.

    Args:
        label: the prompt that it answers to.
        instance: where it is, how sure, and which vertices it has.
        box: the upright box around it.
        witnesses: int64 [W], what to ask whether it is this or that: regions of `Sightings`, or
            vertices where there are none.
        views: frames in which the detector found it; None where nobody knows.
    """

    label: str
    instance: Instance
    box: OrientedBox
    witnesses: np.ndarray
    views: int | None = None


def object_of_vertices(objects: Sequence[SceneObject], count: int) -> np.ndarray:
    """The number of the object that each of `count` vertices is of, int64 [V]; -1 for none."""
    numbers = np.full(count, -1)
    for number, thing in enumerate(objects):
        numbers[thing.instance.vertices] = number
    return numbers
