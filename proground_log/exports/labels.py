"""What the vertices of a map's surface are called: what the objects are that they are of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proground_log.mapping.objects import SceneObject
from proground_log.perception.task import Task
from proground_log.query.objects import object_of_vertices

BACKGROUND_NAME = "background"
DIMMED = 0.7
"""Brightness of the background among the colours of labels."""


@dataclass(frozen=True)
class SurfaceLabels:
    """Labels of vertices, in the terms of a labelled mesh.

    Args:
        labels: uint16 [V], 1 + the number of the prompt of the object that a vertex is of; 0 for
            background, which is all that is of none.
        instances: uint16 [V], the object's number from 1; 0 likewise.
        scores: float32 [V], the object's score; 0 likewise.
        names: of the labels, "background" first.
        palette: uint8 [K + 1, 3] RGB, the labels' colours; that of background is black.
    """

    labels: np.ndarray
    instances: np.ndarray
    scores: np.ndarray
    names: tuple[str, ...]
    palette: np.ndarray

    def colors(self, own: np.ndarray) -> np.ndarray:
        """The vertices in their labels' colours, uint8 [V, 3] RGB.

        Args:
            own: uint8 [V, 3], the vertices' own colours: of background they stay as dim greys, so
                that one still knows the place.
        """
        gray = (DIMMED * own.mean(axis=1, keepdims=True)).round().astype(np.uint8)
        return np.where(self.labels[:, None] > 0, self.palette[self.labels], gray)


def label_surface(vertices: int, objects: Sequence[SceneObject], task: Task) -> SurfaceLabels:
    """Give the vertices of a surface the labels of its objects.

    Args:
        vertices: how many there are.
        objects: what `Surface.objects` found on that surface.
        task: the one that the objects' labels are prompts of.
    """
    # The last row stands for no object, whose number is -1.
    label = np.array([1 + task.prompts.index(thing.label) for thing in objects] + [0], np.uint16)
    score = np.array([thing.score for thing in objects] + [0], np.float32)
    numbers = object_of_vertices(objects, vertices)
    return SurfaceLabels(
        labels=label[numbers],
        instances=(1 + numbers).astype(np.uint16),
        scores=score[numbers],
        names=(BACKGROUND_NAME, *task.prompts),
        palette=np.concatenate([np.zeros((1, 3), np.uint8), task.prompt_colors()])[
            : 1 + len(task.prompts)
        ],
    )
