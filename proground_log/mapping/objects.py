"""The record of an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proground_log.mapping.boxes import OrientedBox


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a map.

    Args:
        label: the prompt that it answers to.
        position_m: float64 [3], world axes.
        lower_m, upper_m: float64 [3], its extent along the world's axes.
        score: how sure it is, in [0, 1]; of an answer, for what was asked.
        vertices: int64 [N], numbers of its vertices on the surface it was found on, rising; none of
            an object that a map tells apart by itself, before it is laid on a surface.
        box: the upright box around it.
        witnesses: int64 [W], what to ask whether it is this or that: regions of `Sightings`, or
            vertices where there are none.
        views: frames in which the detector found it; None where nobody knows.
    """

    label: str
    position_m: np.ndarray
    lower_m: np.ndarray
    upper_m: np.ndarray
    score: float
    vertices: np.ndarray
    box: OrientedBox
    witnesses: np.ndarray
    views: int | None = None
