"""Objects on a surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from proground_log.mapping.boxes import box_around
from proground_log.mapping.objects import SceneObject
from proground_log.query.instances import Instance

LEAST_RELEVANCE = 0.1
"""An object's mean relevance: what wins with less, wins among prompts of which none fits."""


def object_of_vertices(objects: Sequence[SceneObject], count: int) -> np.ndarray:
    """The number of the object that each of `count` vertices is of, int64 [V]; -1 for none."""
    numbers = np.full(count, -1)
    for number, thing in enumerate(objects):
        numbers[thing.vertices] = number
    return numbers


def object_of(
    label: str,
    instance: Instance,
    vertices_m: np.ndarray,
    up: np.ndarray,
    witnesses: np.ndarray,
    views: int | None = None,
) -> SceneObject:
    """The object that an instance on a surface is, in the upright box of its vertices."""
    return SceneObject(
        label,
        instance.position_m,
        instance.lower_m,
        instance.upper_m,
        instance.score,
        instance.vertices,
        box_around(vertices_m[instance.vertices], up),
        witnesses,
        views,
    )
