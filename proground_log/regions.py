"""What perception found in one colour image: regions with relevance and embedding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEVELS = 3
"""Levels of a detector's feature pyramid: P3, P4, P5, strides 8, 16, 32."""
EMBEDDING_WIDTH = 512
"""Width of a region's embedding, and of a text's."""


@dataclass(frozen=True)
class Regions:
    """The regions of one image, by falling relevance to the best prompt.

    Args:
        boxes: float32 [N, 4], x0 y0 x1 y1 in pixels of the colour image, 0 at its left and upper
            edge.
        levels: uint8 [N], 0 to 2: the level of the feature pyramid that found it.
        relevance: float32 [N, K] in [0, 1]: relevance to each prompt of the task (c_tau of the
            paper's Eq. 3 for the best one).
        embeddings: float16 [N, 512], before the head of their level.
        owner: uint16 [H, W]: at each pixel of the colour image 1 + the number of the region that
            it belongs to, 0 for none. Masks that overlap are settled: the higher relevance wins.
        is_box: bool [N], regions for which no mask fitted, so that the whole box stands in.
    """

    boxes: np.ndarray
    levels: np.ndarray
    relevance: np.ndarray
    embeddings: np.ndarray
    owner: np.ndarray
    is_box: np.ndarray

    def __len__(self) -> int:
        return len(self.boxes)

    @property
    def labels(self) -> np.ndarray:
        """The most relevant prompt of each region, int64 [N]."""
        return self.relevance.argmax(axis=1) if len(self) else np.zeros(0, np.int64)

    @property
    def confidence(self) -> np.ndarray:
        """The relevance to it, float32 [N]."""
        return self.relevance.max(axis=1, initial=0)
