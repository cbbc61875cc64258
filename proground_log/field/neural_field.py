"""The neural field: a point in space in, signed distance and colour out."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from proground_log.bounds import Bounds
from proground_log.field.config import FieldConfig, SemanticSpace
from proground_log.field.decoders import Decoders
from proground_log.field.encodings import (
    FEATURES_PER_LEVEL,
    ONE_BLOB_BINS,
    HashGridLayout,
    hash_grid,
    one_blob,
)
from proground_log.field.semantic_heads import PointFeatures
from proground_log.streams import stream

ROOM_M3 = 150.0
"""A box of this size gets hash levels of 2^16 rows, as Co-SLAM gives the rooms of Replica."""
LEAST_POINTS = 16
"""Fewer are never asked: products of 5 to 11 rows differ in the last bit with torch's threads."""


def log2_rows_for(bounds: Bounds) -> int:
    """Rows of a hash level for a box, as a power of two: they grow with its volume, to 2^18."""
    rooms = float(bounds.size_m.prod()) / ROOM_M3
    return int(np.clip(round(16 + np.log2(rooms)), 16, 18))


class NeuralField(nn.Module):
    """The paper's representation (4.2): hash grid and one-blob encoding, two small decoders.

    Args:
        config: sizes.
        bounds: the box that is normalised to [0, 1]^3.
        seed: of the initial weights.
    """

    def __init__(self, config: FieldConfig, bounds: Bounds, seed: int) -> None:
        super().__init__()
        self.config, self.bounds = config, bounds
        self.layout = HashGridLayout(
            config.levels,
            config.log2_rows or log2_rows_for(bounds),
            config.base_resolution,
            float(bounds.size_m.max()) / config.voxel_m,
        )
        table = stream(seed, "table").random(
            (self.layout.rows, FEATURES_PER_LEVEL), dtype=np.float32
        )
        self.table = nn.Parameter(torch.from_numpy((2 * table - 1) * np.float32(1e-4)))
        self.decoders = Decoders(
            FEATURES_PER_LEVEL * config.levels, 3 * ONE_BLOB_BINS, stream(seed, "decoders")
        )
        self.register_buffer("lower_m", torch.tensor(bounds.lower_m, dtype=torch.float32), False)
        size_m = torch.from_numpy(bounds.size_m.astype(np.float32))
        self.register_buffer("size_m", size_m, False)
        self.register_buffer("aspect", size_m / size_m.max(), False)
        self.aspect: Tensor
        self.lower_m: Tensor
        self.size_m: Tensor

    @property
    def hash_width(self) -> int:
        """Number of hash features of a point."""
        return FEATURES_PER_LEVEL * self.layout.levels

    def normalise(self, points_m: Tensor) -> tuple[Tensor, Tensor]:
        """Points [N, 3] in world metres to [0, 1]^3, clamped, and which lay inside, bool [N]."""
        points = (points_m - self.lower_m) / self.size_m
        clamped = points.clamp(0, 1)
        return clamped, (points == clamped).all(dim=1)

    def hash_features(self, points: Tensor) -> Tensor:
        """Hash features [N, 2 levels] of normalised points [N, 3].

        The cells are cubes in space. Published code stretches them with the bounds: in a flat
        house they are six times as long as high, and edges come out ragged.
        """
        return hash_grid(points * self.aspect, self.table, self.layout)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Ask the field at normalised points [N, 3]; see `decode`."""
        enough, count = _enough(points), len(points)
        sdf, color = self.decode(enough, self.hash_features(enough))
        return sdf[:count], color[:count]

    def decode(self, points: Tensor, hashed: Tensor) -> tuple[Tensor, Tensor]:
        """Decode normalised points [N, 3] and their hash features [N, 2 levels].

        Returns:
            SDF in units of the truncation [N], colour in [0, 1] [N, 3].
        """
        blob = one_blob(points)
        geometry = self.decoders.geometry(hashed, blob)
        color, _ = self.decoders.color(geometry, blob)
        return geometry[:, 0], color

    @torch.no_grad()
    def with_features(
        self, points: Tensor, space: SemanticSpace
    ) -> tuple[Tensor, Tensor, PointFeatures]:
        """As `forward`, and what the semantic heads look at; nothing here gets a gradient."""
        enough, count = _enough(points), len(points)
        hashed, blob = self.hash_features(enough), one_blob(enough)
        geometry = self.decoders.geometry(hashed, blob)
        color, color_features = self.decoders.color(geometry, blob)
        sources = {"color": color_features, "geometry": geometry[:, 1:], "parametric": hashed}
        chosen = [sources[space.features]] if space.features in sources else []
        chosen += [blob] if space.coordinates else []
        features = (torch.cat(chosen, dim=1), hashed, blob)
        return geometry[:count, 0], color[:count], PointFeatures(*(f[:count] for f in features))

    def sdf(self, points: Tensor) -> Tensor:
        """SDF in units of the truncation, [N], of normalised points [N, 3]."""
        enough = _enough(points)
        return self.decoders.sdf(self.hash_features(enough), one_blob(enough))[: len(points)]


def _enough(points: Tensor) -> Tensor:
    """The points [N, 3], and the origin as often as it takes to make them `LEAST_POINTS`."""
    return pad(points, (0, 0, 0, max(LEAST_POINTS - len(points), 0)))
