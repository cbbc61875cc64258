"""The decoders of geometry and colour."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

GEOMETRY_FEATURES = 15
HIDDEN = 32


def linear_weight(outputs: int, inputs: int, random: np.random.Generator) -> nn.Parameter:
    """A weight [outputs, inputs] from U(-1/sqrt(inputs), 1/sqrt(inputs)), as torch's Linear."""
    bound = 1 / math.sqrt(inputs)
    weight = (2 * random.random((outputs, inputs), dtype=np.float32) - 1) * np.float32(bound)
    return nn.Parameter(torch.from_numpy(weight))


class Decoders(nn.Module):
    """Two-layer networks without bias: [hash, one-blob] -> SDF, and [one-blob, f_g] -> colour.

    Follows paper 4.2. A layer over concatenated inputs is computed as a sum of two products:
    nothing is copied together, and no gradient is computed for the one-blob encoding.

    Args:
        hash_features, blob_features: widths of the encodings.
        random: draws the initial weights.
    """

    def __init__(self, hash_features: int, blob_features: int, random: np.random.Generator) -> None:
        super().__init__()
        self.hash_features, self.blob_features = hash_features, blob_features
        geometry_inputs = hash_features + blob_features
        color_inputs = blob_features + GEOMETRY_FEATURES
        self.geometry_hidden = linear_weight(HIDDEN, geometry_inputs, random)
        self.geometry_out = linear_weight(1 + GEOMETRY_FEATURES, HIDDEN, random)
        self.color_hidden = linear_weight(HIDDEN, color_inputs, random)
        self.color_out = linear_weight(3, HIDDEN, random)

    def geometry(self, hashed: Tensor, blob: Tensor) -> Tensor:
        """SDF in units of the truncation (column 0) and f_g, [N, 16]."""
        of_hash, of_blob = self.geometry_hidden.split([self.hash_features, self.blob_features], 1)
        hidden = torch.addmm(blob @ of_blob.t(), hashed, of_hash.t()).relu_()
        return hidden @ self.geometry_out.t()

    def sdf(self, hashed: Tensor, blob: Tensor) -> Tensor:
        """SDF alone, in units of the truncation, [N]."""
        of_hash, of_blob = self.geometry_hidden.split([self.hash_features, self.blob_features], 1)
        hidden = torch.addmm(blob @ of_blob.t(), hashed, of_hash.t()).relu_()
        return hidden @ self.geometry_out[0]

    def color(self, geometry: Tensor, blob: Tensor) -> tuple[Tensor, Tensor]:
        """Colour in [0, 1], [N, 3], and f_c, the hidden activation behind it, [N, 32]."""
        of_blob, of_geometry = self.color_hidden.split([self.blob_features, GEOMETRY_FEATURES], 1)
        hidden = torch.addmm(blob @ of_blob.t(), geometry[:, 1:], of_geometry.t()).relu_()
        return (hidden @ self.color_out.t()).sigmoid_(), hidden
