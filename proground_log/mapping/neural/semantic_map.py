"""The part of a map that says what things are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch

from proground_log.field.semantic_heads import PointFeatures, SemanticHeads
from proground_log.perception.description import PerceptionDescription


@dataclass(frozen=True)
class Semantics:
    """What the heads say of points or rays.

    Args:
        embeddings: float32 [N, 512], before the detector's heads.
        scale_logits: float32 [N, 4]: the three pyramid levels, and "no supervision".
        uncertainty: float32 [N] in [0, 1], how likely a point is without supervision.
    """

    embeddings: np.ndarray
    scale_logits: np.ndarray
    uncertainty: np.ndarray

    @staticmethod
    def concatenate(parts: Sequence[Semantics]) -> Semantics:
        """All of them, one after the other."""
        return Semantics(
            *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Semantics))
        )


@dataclass(frozen=True)
class SemanticMap:
    """Trained heads, and what their embeddings mean.

    Args:
        heads: the semantic heads.
        description: the task, its texts and the detector's heads.
    """

    heads: SemanticHeads
    description: PerceptionDescription

    @torch.no_grad()
    def decode(self, features: PointFeatures) -> Semantics:
        """Ask the heads."""
        return Semantics(
            self.heads.embeddings(features).cpu().numpy(),
            self.heads.scale_logits(features).cpu().numpy(),
            self.heads.uncertainty_logits(features).sigmoid().cpu().numpy(),
        )
