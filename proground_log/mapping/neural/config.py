"""Settings of the online mapper."""

from __future__ import annotations

from dataclasses import dataclass

from proground_log.field.config import FieldConfig, SemanticSpace


@dataclass(frozen=True)
class SamplingConfig:
    """Rays of a step, and samples of a ray."""

    rays: int = 1024
    """Rays of a step, current frame and replay buffer together."""
    current_share: float = 0.25
    """Share of them that look at the newest frame."""
    uniform: int = 28
    """Samples spread evenly over a ray."""
    near_surface: int = 15
    """Samples spread over the surface's range."""
    near_m: float = 0.05
    """Where a ray begins to be sampled."""
    range_m: float = 0.05
    """The surface's range is the measured depth, give or take this."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the loss terms."""

    rgb: float = 5.0
    depth: float = 0.1
    sdf: float = 200.0
    free_space: float = 10.0
    smoothness: float = 1e-3
    semantic: float = 1.0
    scale: float = 1.0
    uncertainty: float = 1.0


@dataclass(frozen=True)
class SemanticsConfig:
    """How meaning is learnt, where there are regions to learn it from (paper 4.3)."""

    enabled: bool = True
    """Learn it."""
    space: SemanticSpace = SemanticSpace()
    filter_regions: bool = True
    """Learn from regions above the task's relevance threshold alone (lambda_tau in Eq. 3)."""
    weight_regions: bool = True
    """Weight each region by its relevance (c_tau in Eq. 5)."""
    squared_norm: bool = False
    """Square the norm in Eq. 5."""
    rays: int = 256
    """Semantic rays of a step, apart from those of colour and geometry."""
    background_rays: int = 128
    """Rays of a step that hit no region: they teach what is without supervision."""
    samples: int = 11
    """Samples of such a ray, over the surface's range."""
    capacity: int = 200_000
    """Most semantic rays held, and most background rays."""
    frame_rays: int = 4_000
    """Semantic rays remembered of a mapped frame, and background rays."""
    balance: float = 0.5
    """Labels are drawn in proportion to their rays to this power: 1 every ray alike, 0 every label
    alike."""


@dataclass(frozen=True)
class BufferConfig:
    """The replay buffer."""

    capacity: int = 1_000_000
    """Most samples held."""
    keyframe_samples: int = 10_000
    """Pixels kept of a keyframe."""
    place_m: float = 0.25
    """Side of the cells among which the buffer shares out its samples."""


@dataclass(frozen=True)
class NeuralConfig:
    """Everything that decides what the mapper learns, seed aside."""

    field: FieldConfig = FieldConfig()
    sampling: SamplingConfig = SamplingConfig()
    weights: LossWeights = LossWeights()
    buffer: BufferConfig = BufferConfig()
    semantics: SemanticsConfig = SemanticsConfig()
    beta: float = 1.0
    """Weight of a replayed ray against one of the current frame (paper, Eq. 2)."""
    learning_rate: float = 1e-2
    """Adam's, for table and decoders."""
    average_share: float = 0.2
    """Share of the newest parameters in the averaged field, the map, every ten steps."""
    smoothness_points: int = 8
    """Points along an axis of the lattice that the smoothness loss looks at."""
    smoothness_spacing_m: float = 0.1
    """Distance between them."""
