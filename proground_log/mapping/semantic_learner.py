"""Selective experience replay: what to learn meaning from, and learning it (paper 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from proground_log.events import SemanticScores, SemanticStatistics
from proground_log.field.losses import focal_loss, semantic_loss, uncertainty_loss
from proground_log.field.neural_field import NeuralField
from proground_log.field.rendering import before_surface, sdf_weights
from proground_log.field.sampling import sample_depths
from proground_log.field.semantic_heads import NO_SUPERVISION, PointFeatures, SemanticHeads
from proground_log.frame import NO_REGION, Frame
from proground_log.mapping.config import LossWeights, MapperConfig
from proground_log.mapping.optimiser import ADAM_BETAS, restore_training, training_state, under
from proground_log.mapping.replay_buffer import RaySamples, ReplayBuffer, ray_samples
from proground_log.mapping.semantic_buffer import RegionTable, SemanticBuffer, SemanticRays
from proground_log.mapping.water_level import below_water_level
from proground_log.perception.description import PerceptionDescription
from proground_log.regions import LEVELS
from proground_log.streams import stream

SCORED_RAYS = 512
"""Rays on which the heads are judged after a frame."""


@dataclass(frozen=True)
class SemanticInsertion:
    """What a keyframe brought: rays that came in, and rays that had to go."""

    inserted: int
    evicted: int


@dataclass(frozen=True)
class SemanticStep:
    """Loss terms of a step, their weighted sum, and the draws behind them."""

    losses: dict[str, float]
    total: float
    draws: list[np.ndarray]


class SemanticLearner:
    """Trains the semantic heads beside a field that it never touches.

    Args:
        config: the mapper's settings.
        description: what the regions mean.
        field: the field; only read.
        seed: of every random draw.
    """

    def __init__(
        self,
        config: MapperConfig,
        description: PerceptionDescription,
        field: NeuralField,
        seed: int,
    ) -> None:
        self.description = description
        self._config, self._settings = config.sampling, config.semantics
        self._weights: LossWeights = config.weights
        self._field, self._seed = field, seed
        self._device = field.table.device
        self.heads = SemanticHeads(self._settings.space, field.hash_width, seed).to(self._device)
        self._optimiser = torch.optim.Adam(
            self.heads.parameters(), lr=config.learning_rate, betas=ADAM_BETAS, fused=True
        )
        self._buffer = SemanticBuffer(self._settings.capacity, self._settings.balance)
        self._background = ReplayBuffer(self._settings.capacity, config.buffer.place_m)
        self._table = RegionTable.empty()
        self._rays = SemanticRays.empty()
        self._unlabelled = RaySamples.empty()

    def insert(self, frame: Frame, pixels: np.ndarray, *, keyframe: bool) -> SemanticInsertion:
        """Choose what to learn from the newest frame; a keyframe's choice is remembered.

        Args:
            frame: the frame; without regions it teaches nothing.
            pixels: flat numbers of its usable pixels.
            keyframe: whether it is one.
        """
        self._table, self._rays = RegionTable.empty(), SemanticRays.empty()
        self._unlabelled = RaySamples.empty()
        if frame.regions is None or frame.region_of is None or not len(pixels):
            return SemanticInsertion(0, 0)
        random = stream(self._seed, "semantic buffer", frame.index)
        table = RegionTable.of(frame.regions)
        teaches = np.ones(len(table), bool)
        if self._settings.filter_regions:
            teaches = table.confidence > self.description.task.thresholds.relevance
        owner = frame.region_of.reshape(-1)[pixels]
        # The last entry stands for all pixels without a region, even where there are no regions.
        is_region = np.append(teaches, False)[np.maximum(owner, -1)]
        candidates, owner_of = pixels[is_region], owner[is_region]
        if len(candidates):
            ranks = random.integers(0, 2**32, size=len(candidates), dtype=np.uint32)
            chosen = below_water_level(
                owner_of.astype(np.int64), ranks, self._settings.keyframe_rays
            )
            rays = ray_samples(frame, candidates[chosen])
            self._table = table
            self._rays = SemanticRays(
                rays.origins_m, rays.directions, rays.depth_m, owner_of[chosen].astype(np.int32)
            )
        # A thing that is hardly recognised is no background either: it teaches nothing.
        candidates = pixels[owner == NO_REGION]
        if len(candidates):
            count = min(self._settings.keyframe_rays, len(candidates))
            chosen = np.sort(random.choice(candidates, size=count, replace=False))
            self._unlabelled = ray_samples(frame, chosen)
        if not keyframe:
            return SemanticInsertion(0, 0)
        evicted = self._buffer.insert(self._rays, self._table, random)
        evicted += self._background.insert(frame.index, self._unlabelled, random)
        return SemanticInsertion(len(self._rays) + len(self._unlabelled), evicted)

    def step(self, frame_index: int, iteration: int) -> SemanticStep | None:
        """One step of the heads; None where there is nothing yet to learn from."""
        random = stream(self._seed, "semantic rays", frame_index, iteration)
        batch = self._draw(self._settings.rays, self._settings.background_rays, random)
        if batch is None:
            return None
        rendered = self._render(batch, random)
        terms: dict[str, Tensor] = {}
        supervised = len(batch.table)
        classes = torch.full((len(batch),), NO_SUPERVISION, device=self._device)
        classes[:supervised] = self._tensor(batch.table.levels).long()
        if supervised:
            observed = self._tensor(batch.table.embeddings).float()
            confidence = self._tensor(batch.table.confidence)
            if not self._settings.weight_regions:
                confidence = torch.ones_like(confidence)
            embeddings = self.heads.embeddings(rendered)[:supervised]
            terms["semantic"] = semantic_loss(embeddings, observed, confidence)
        terms["scale"] = focal_loss(self.heads.scale_logits(rendered), classes)
        terms["uncertainty"] = uncertainty_loss(
            self.heads.uncertainty_logits(rendered), classes == NO_SUPERVISION
        )
        total = torch.stack(
            [getattr(self._weights, name) * term for name, term in terms.items()]
        ).sum()
        self._optimiser.zero_grad(set_to_none=True)
        total.backward()
        self._optimiser.step()
        values = torch.stack([*terms.values(), total]).detach().cpu().tolist()
        return SemanticStep(dict(zip(terms, values, strict=False)), values[-1], batch.draws)

    @torch.no_grad()
    def scores(self, frame_index: int) -> SemanticScores | None:
        """How well the heads give back what the regions say, on fresh draws."""
        random = stream(self._seed, "semantic scores", frame_index)
        batch = self._draw(SCORED_RAYS, SCORED_RAYS, random)
        if batch is None:
            return None
        rendered = self._render(batch, random)
        supervised = len(batch.table)
        levels = self.heads.scale_logits(rendered).argmax(dim=1).cpu().numpy()
        unsure = (self.heads.uncertainty_logits(rendered) > 0).cpu().numpy()
        embeddings = self.heads.embeddings(rendered)[:supervised].cpu().numpy()
        labels = np.zeros(supervised, np.int64)
        for level in range(LEVELS):
            at = batch.table.levels == level
            texts = self.description.texts
            labels[at] = self.description.heads.logits(embeddings[at], level, texts).argmax(axis=1)
        is_background = np.arange(len(levels)) >= supervised
        return SemanticScores(
            frame_index=frame_index,
            label=_share(labels == batch.table.labels),
            scale=_share(levels[:supervised] == batch.table.levels),
            background=_share(levels[supervised:] == NO_SUPERVISION),
            uncertainty=_share(unsure == is_background),
        )

    def _draw(self, rays: int, background_rays: int, random: np.random.Generator) -> _Batch | None:
        """Rays of regions first, then of the background; the newest frame has its share."""
        parts: list[SemanticRays] = []
        tables: list[RegionTable] = []
        draws: list[np.ndarray] = []
        current = self._current_share(rays, len(self._rays), len(self._buffer))
        if current:
            draws.append(random.integers(0, len(self._rays), size=current))
            parts.append(self._rays.take(draws[-1]))
            tables.append(self._table.take(parts[-1].regions))
        if len(self._buffer) and current < rays:
            draws.append(self._buffer.draw(rays - current, random))
            parts.append(self._buffer.take(draws[-1]))
            tables.append(self._buffer.table.take(parts[-1].regions))
        unlabelled: list[RaySamples] = []
        current = self._current_share(background_rays, len(self._unlabelled), len(self._background))
        if current:
            draws.append(random.integers(0, len(self._unlabelled), size=current))
            unlabelled.append(self._unlabelled.take(draws[-1]))
        if len(self._background) and current < background_rays:
            draws.append(random.integers(0, len(self._background), size=background_rays - current))
            unlabelled.append(self._background.take(draws[-1]))
        if not draws:
            return None
        table = RegionTable.empty()
        for part in tables:
            table = RegionTable.concatenate(table, part)
        rays_of = [*parts, *unlabelled]
        origins_m, directions, depth_m = (
            np.concatenate([getattr(part, name) for part in rays_of])
            for name in ("origins_m", "directions", "depth_m")
        )
        return _Batch(origins_m, directions, depth_m, table, draws)

    def _current_share(self, rays: int, available: int, remembered: int) -> int:
        """How many of the rays look at the newest frame."""
        if not available:
            return 0
        return round(rays * self._config.current_share) if remembered else rays

    def _render(self, batch: _Batch, random: np.random.Generator) -> PointFeatures:
        """What the heads look at, composited along each ray (Eq. 4)."""
        depths_m = sample_depths(
            batch.depth_m,
            uniform=0,
            near_surface=self._settings.samples,
            near_m=self._config.near_m,
            range_m=self._config.range_m,
            jitter=random.random((len(batch), self._settings.samples), dtype=np.float32),
        )
        z_m = self._tensor(depths_m)
        origins_m, directions = self._tensor(batch.origins_m), self._tensor(batch.directions)
        points_m = origins_m[:, None] + directions[:, None] * z_m[..., None]
        points, inside = self._field.normalise(points_m.reshape(-1, 3))
        sdf, _, features = self._field.with_features(points, self._settings.space)
        sdf = sdf.reshape(z_m.shape)
        tr_m = self._field.config.truncation_m
        counts = inside.reshape(z_m.shape) & before_surface(sdf, z_m, tr_m)
        return features.rendered(sdf_weights(sdf, counts))

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device)

    def statistics(self) -> SemanticStatistics:
        """Figures for telemetry."""
        labels, levels = self._buffer.counts()
        prompts = self.description.task.all_prompts
        counted = np.zeros(len(prompts), np.int64)
        counted[: len(labels)] = labels
        arrays = [*self._buffer.state().values(), *self._background.state().values()]
        return SemanticStatistics(
            samples=len(self._buffer),
            capacity=self._settings.capacity,
            background=len(self._background),
            regions=len(self._buffer.table),
            labels=dict(zip(prompts, counted.tolist(), strict=True)),
            levels=levels.tolist(),
            size_bytes=sum(array.nbytes for array in arrays),
        )

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame builds on, by name."""
        state = training_state(self.heads, self._optimiser)
        for part, buffer in (("buffer", self._buffer), ("background", self._background)):
            state |= {f"{part}/{name}": array for name, array in buffer.state().items()}
        return state

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned, after the last step of a frame."""
        restore_training(self.heads, self._optimiser, state)
        self._buffer.restore(under("buffer", state))
        self._background.restore(under("background", state))
        self._table, self._rays = RegionTable.empty(), SemanticRays.empty()
        self._unlabelled = RaySamples.empty()


@dataclass(frozen=True)
class _Batch:
    """Rays of regions, then of the background, with the regions of the former and the draws."""

    origins_m: np.ndarray
    directions: np.ndarray
    depth_m: np.ndarray
    table: RegionTable
    draws: list[np.ndarray]

    def __len__(self) -> int:
        return len(self.depth_m)


def _share(hits: np.ndarray) -> float:
    """Share of hits in percent; nan where there was nothing to hit."""
    return 100 * float(hits.mean()) if len(hits) else float("nan")
