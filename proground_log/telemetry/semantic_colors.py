"""Embeddings as colours: a PCA whose basis is fixed for the run (paper, Fig. 3)."""

from __future__ import annotations

import numpy as np

from proground_log.perception.description import PerceptionDescription

CONTRAST = 1.5
"""Standard deviations of the task's texts that the colours span, to either side."""
LEAST_SPREAD = 0.1
"""Least standard deviation: a direction in which the texts hardly differ shows no noise."""


class SemanticColors:
    """Colours by where an embedding lies among the task's texts.

    The basis comes from the texts, not from what was mapped, so that it stands before the first
    frame and a colour means the same in every view of a run and of another with the same task.

    Args:
        description: has the task's texts.
    """

    def __init__(self, description: PerceptionDescription) -> None:
        texts = description.texts.astype(np.float64)
        self._mean = texts.mean(axis=0)
        # Fewer than four texts span fewer than three directions: unit vectors fill up.
        spanning = np.concatenate([texts - self._mean, 1e-6 * np.eye(texts.shape[1])[:3]])
        _, _, directions = np.linalg.svd(spanning, full_matrices=False)
        basis = directions[:3]
        # The sign of a singular vector is any: its largest entry is made positive.
        largest = np.abs(basis).argmax(axis=1)
        self._basis = basis * np.sign(basis[np.arange(3), largest])[:, None]
        spread = ((texts - self._mean) @ self._basis.T).std(axis=0)
        self._range = CONTRAST * np.maximum(spread, LEAST_SPREAD)

    def __call__(self, embeddings: np.ndarray) -> np.ndarray:
        """RGB, uint8 [N, 3], of embeddings float32 [N, 512] in the texts' space, of length 1."""
        place = (embeddings @ self._basis.T.astype(np.float32)).astype(np.float64)
        place -= self._basis @ self._mean
        return (255 * (0.5 + 0.5 * np.clip(place / self._range, -1, 1))).round().astype(np.uint8)
