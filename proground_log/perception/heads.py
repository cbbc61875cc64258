"""The detector's text-contrastive heads: from a region's embedding to logits for texts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TextHeads:
    """One head a level of the feature pyramid (YOLO-World v2; v1 with scale 1, shift 0).

    logit = exp(logit_scale_k) <scale_k * x + shift_k, t> + bias_k. The levels' embeddings live in
    three different spaces; the heads bring them into that of the texts.

    Args:
        scale, shift: float32 [3, 512].
        logit_scale, bias: float32 [3].
    """

    scale: np.ndarray
    shift: np.ndarray
    logit_scale: np.ndarray
    bias: np.ndarray

    def logits(self, embeddings: np.ndarray, level: int, texts: np.ndarray) -> np.ndarray:
        """Logits [N, K] of embeddings [N, 512] of one level for texts [K, 512] of length 1."""
        aligned = embeddings.astype(np.float32) * self.scale[level] + self.shift[level]
        return aligned @ texts.T * np.exp(self.logit_scale[level]) + self.bias[level]

    def in_text_space(self, embeddings: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """What embeddings [N, 512] of levels [N] come to whatever the text, float32 [N, 513].

        With g the first 512 numbers of a row and b the last, its logit for a text t is <g, t> + b:
        so the mean of rows has the mean of their logits.
        """
        factor = np.exp(self.logit_scale)[levels, None]
        aligned = embeddings.astype(np.float32) * self.scale[levels] + self.shift[levels]
        return np.concatenate([factor * aligned, self.bias[levels, None]], axis=1)
