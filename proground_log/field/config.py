"""Settings of the neural field."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FieldConfig:
    """Size and resolution of the field."""

    log2_rows: int | None = None
    """Rows of a hash level, as a power of two; by default 16 for a room, up to 19 for a house."""
    levels: int = 16
    """Levels of the hash grid."""
    base_resolution: int = 16
    """Cells along an axis at the coarsest level."""
    voxel_m: float = 0.02
    """Cell size at the finest level, along the longest side of the bounds."""
    truncation_m: float = 0.1
    """Distance from a surface up to which the field is a signed distance."""
