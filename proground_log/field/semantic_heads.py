"""The heads of meaning: semantic embedding, pyramid level and uncertainty (paper 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor, nn

from proground_log.field.config import SemanticSpace
from proground_log.field.decoders import GEOMETRY_FEATURES, HIDDEN, linear_weight
from proground_log.field.encodings import ONE_BLOB_BINS
from proground_log.field.rendering import composite
from proground_log.regions import EMBEDDING_WIDTH, LEVELS
from proground_log.streams import stream

NO_SUPERVISION = LEVELS
"""Class of the scale head for what no region covers."""


@dataclass(frozen=True)
class PointFeatures:
    """What the heads look at, of the same points; detached from geometry and colour.

    Args:
        space: [N, C], the features of the chosen `SemanticSpace`.
        hashed: [N, 2 levels], the hash features.
        blob: [N, 48], the one-blob encoding.
    """

    space: Tensor
    hashed: Tensor
    blob: Tensor

    @staticmethod
    def concatenate(parts: Sequence[PointFeatures]) -> PointFeatures:
        """All of them, one after the other."""
        return PointFeatures(
            *(torch.cat([getattr(part, f.name) for part in parts]) for f in fields(PointFeatures))
        )

    def rendered(self, weights: Tensor) -> PointFeatures:
        """The features that rays see: samples [R * S, C] composited with weights [R, S].

        The heads are linear and the weights add up to 1, so that projecting what was composited
        equals compositing what was projected, at a fraction of the work.
        """

        def along_rays(values: Tensor) -> Tensor:
            return composite(weights, values.reshape(*weights.shape, values.shape[1]))

        return PointFeatures(*map(along_rays, (self.space, self.hashed, self.blob)))


class SemanticHeads(nn.Module):
    """Three linear layers, trained apart from geometry and colour.

    Args:
        space: what the semantic head looks at.
        hash_features: width of the hash features, which the scale head looks at.
        seed: of the initial weights.
    """

    def __init__(self, space: SemanticSpace, hash_features: int, seed: int) -> None:
        super().__init__()
        self.space = space
        random = stream(seed, "semantic heads")
        widths = {"color": HIDDEN, "geometry": GEOMETRY_FEATURES, "parametric": hash_features}
        blob = 3 * ONE_BLOB_BINS
        inputs = widths.get(space.features, 0) + blob * space.coordinates
        self.semantic = linear_weight(EMBEDDING_WIDTH, inputs, random)
        self.scale = linear_weight(LEVELS + 1, hash_features, random)
        self.uncertainty = linear_weight(1, blob, random)
        self.semantic_bias = nn.Parameter(torch.zeros(EMBEDDING_WIDTH))
        self.scale_bias = nn.Parameter(torch.zeros(LEVELS + 1))
        self.uncertainty_bias = nn.Parameter(torch.zeros(1))

    def embeddings(self, features: PointFeatures) -> Tensor:
        """Embeddings as the detector has them before its heads, [N, 512]."""
        return torch.addmm(self.semantic_bias, features.space, self.semantic.t())

    def scale_logits(self, features: PointFeatures) -> Tensor:
        """Logits of the three pyramid levels and of "no supervision", [N, 4]."""
        return torch.addmm(self.scale_bias, features.hashed, self.scale.t())

    def uncertainty_logits(self, features: PointFeatures) -> Tensor:
        """Logits of a point being without supervision, [N]."""
        return torch.addmm(self.uncertainty_bias, features.blob, self.uncertainty.t())[:, 0]
