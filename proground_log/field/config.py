"""Settings of the neural field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from proground_log.errors import ProgroundError

FeatureSource = Literal["color", "geometry", "parametric", "none"]


@dataclass(frozen=True)
class FieldConfig:
    """Size and resolution of the field."""

    log2_rows: int | None = None
    """Rows of a hash level, as a power of two; by default 16 for a room, up to 18 for a house."""
    levels: int = 16
    """Levels of the hash grid."""
    base_resolution: int = 16
    """Cells along an axis at the coarsest level."""
    voxel_m: float = 0.02
    """Cell size at the finest level, along the longest side of the bounds."""
    truncation_m: float = 0.1
    """Distance from a surface up to which the field is a signed distance."""


@dataclass(frozen=True)
class SemanticSpace:
    """The features that semantics are decoded from (paper, Table 4)."""

    features: FeatureSource = "color"
    """color: f_c; geometry: f_g; parametric: the hash features; none: coordinates alone."""
    coordinates: bool = True
    """Put the one-blob encoding beside them."""

    def __post_init__(self) -> None:
        if self.features == "none" and not self.coordinates:
            raise ProgroundError(
                "semantics would be decoded from nothing",
                where="mapper.semantics.space",
                todo="choose features, or coordinates",
            )
