"""Settings of a replay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from proground_log.frame import Selection
from proground_log.mapping.config import MapperConfig


@dataclass(frozen=True)
class TelemetryConfig:
    """What goes into the rerun recording besides every loss; none of it touches the map."""

    enabled: bool = True
    """Write telemetry.rrd."""
    view_every: int = 15
    """Every so many mapped frames, the frame's view is rendered."""
    view_width: int = 160
    """Width of the rendered views in pixels."""
    mesh_every: int = 30
    """Every so many mapped frames, the mesh is extracted."""
    mesh_voxel_m: float = 0.05
    """Its voxels; larger ones in a house, so that a mesh stays cheap."""


@dataclass(frozen=True)
class ReplayConfig:
    """Everything that decides a replay, the log aside."""

    steps: int = 10
    """Optimisation steps a mapped frame gets."""
    seed: int = 0
    """Of every random draw."""
    device: str = "auto"
    """auto, cpu or cuda."""
    selection: Annotated[Selection, tyro.conf.arg(name="")] = Selection()
    """Which frames of the log arrive."""
    max_frames: int | None = None
    """Stop after so many of them."""
    hold_out_every: int = 0
    """Keep every so many-th arriving frame from the mapper, for `pglog evaluate`; 0: none."""
    digest_every: int = 100
    """Steps between two fingerprints of the whole state in the ledger."""
    checkpoint_every: int = 50
    """Frames between two checkpoints, from which --resume goes on."""
    mapper: MapperConfig = MapperConfig()
    telemetry: TelemetryConfig = TelemetryConfig()
