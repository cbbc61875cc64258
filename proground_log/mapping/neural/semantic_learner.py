"""Selective experience replay: what to learn meaning from, and learning it (paper 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from proground_log.events import SemanticScores
from proground_log.field.losses import focal_loss, semantic_loss, uncertainty_loss
from proground_log.field.neural_field import NeuralField
from proground_log.field.rendering import before_surface, sdf_weights
from proground_log.field.sampling import sample_depths
from proground_log.field.semantic_heads import NO_SUPERVISION, PointFeatures, SemanticHeads
from proground_log.frame import NO_REGION, Frame
from proground_log.mapping.neural.config import LossWeights, NeuralConfig
from proground_log.mapping.neural.optimiser import (
    ADAM_BETAS,
    restore_training,
    training_state,
    under,
)
from proground_log.mapping.neural.replay_buffer import RaySamples, ReplayBuffer, ray_samples
from proground_log.mapping.neural.semantic_buffer import RegionTable, SemanticBuffer, SemanticRays
from proground_log.mapping.neural.statistics import SemanticStatistics
from proground_log.perception.description import PerceptionDescription
from proground_log.regions import LEVELS
from proground_log.streams import stream

SCORED_RAYS = 512
"""Rays on which the heads are judged after a frame."""


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
        config: NeuralConfig,
        description: PerceptionDescription,
        field: NeuralField,
        seed: int,
    ) -> None:
        self.description = description
        self._sampling, self._settings = config.sampling, config.semantics
        self._weights: LossWeights = config.weights
        self._field, self._seed = field, seed
        self._device = field.table.device
        self.heads = SemanticHeads(self._settings.space, field.hash_width, seed).to(self._device)
        self._optimiser = torch.optim.Adam(
            self.heads.parameters(), lr=config.learning_rate, betas=ADAM_BETAS, fused=True
        )
        self._buffer = SemanticBuffer(self._settings.capacity, self._settings.balance)
        self._background = ReplayBuffer(self._settings.capacity, config.buffer.place_m)
        self._inserted = 0

    def insert(self, frame: Frame, pixels: np.ndarray) -> None:
        """Remember what to learn from a frame.

        Args:
            frame: the frame; without regions it teaches nothing.
            pixels: flat numbers of its usable pixels.
        """
        if frame.regions is None or frame.region_of is None or not len(pixels):
            return
        random = stream(self._seed, "semantic buffer", frame.index)
        table = RegionTable.of(frame.regions)
        teaches = np.ones(len(table), bool)
        if self._settings.filter_regions:
            teaches = table.confidence > self.description.task.thresholds.relevance
        owner = frame.region_of.reshape(-1)[pixels]
        # The last entry stands for all pixels without a region, even where there are no regions.
        is_region = np.append(teaches, False)[np.maximum(owner, -1)]
        owners, candidates = owner[is_region], pixels[is_region]
        chosen = _shared_out(owners, self._settings.frame_rays, random)
        rays = ray_samples(frame, candidates[chosen])
        regions = owners[chosen].astype(np.int32)
        self._buffer.insert(
            SemanticRays(rays.origins_m, rays.directions, rays.depth_m, regions), table, random
        )
        # A thing that is hardly recognised is no background either: it teaches nothing.
        candidates = pixels[owner == NO_REGION]
        count = min(self._settings.frame_rays, len(candidates))
        nothing = np.sort(random.choice(candidates, size=count, replace=False))
        self._background.insert(frame.index, ray_samples(frame, nothing), random)
        self._inserted += len(chosen) + len(nothing)

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
            terms["semantic"] = semantic_loss(
                embeddings, observed, confidence, squared=self._settings.squared_norm
            )
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
        """Rays of regions first, then of the background."""
        table, draws = RegionTable.empty(), []
        parts: list[SemanticRays | RaySamples] = []
        if len(self._buffer):
            draws.append(self._buffer.draw(rays, random))
            of_regions = self._buffer.take(draws[-1])
            parts.append(of_regions)
            table = self._buffer.table.take(of_regions.regions)
        if len(self._background):
            draws.append(random.integers(0, len(self._background), size=background_rays))
            parts.append(self._background.take(draws[-1]))
        if not parts:
            return None
        origins_m, directions, depth_m = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("origins_m", "directions", "depth_m")
        )
        return _Batch(origins_m, directions, depth_m, table, draws)

    def _render(self, batch: _Batch, random: np.random.Generator) -> PointFeatures:
        """What the heads look at, composited along each ray (Eq. 4)."""
        depths_m = sample_depths(
            batch.depth_m,
            uniform=0,
            near_surface=self._settings.samples,
            near_m=self._sampling.near_m,
            range_m=self._sampling.range_m,
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
            inserted=self._inserted,
            evicted=self._inserted - len(self._buffer) - len(self._background),
            size_bytes=sum(array.nbytes for array in arrays),
        )

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame builds on, by name."""
        state = training_state(self.heads, self._optimiser)
        for part, buffer in (("buffer", self._buffer), ("background", self._background)):
            state |= {f"{part}/{name}": array for name, array in buffer.state().items()}
        return state | {"inserted": np.array(self._inserted)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned, after the last step of a frame."""
        restore_training(self.heads, self._optimiser, state)
        self._buffer.restore(under("buffer", state))
        self._background.restore(under("background", state))
        self._inserted = state["inserted"].item()


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


def _shared_out(owners: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Rows of at most `count` pixels, int64 rising, each region in proportion to its area's root.

    In proportion to the area, walls of cupboards leave nothing to cups; in equal parts, every
    pixel of a cup would stand for hundreds of a cupboard's.
    """
    area = np.bincount(owners)[owners]
    # The smallest of exponential draws with these means are a weighted draw without replacement.
    ranks = random.exponential(size=len(owners)) * np.sqrt(area)
    return np.sort(np.argsort(ranks, kind="stable")[:count])


def _share(hits: np.ndarray) -> float:
    """Share of hits in percent; nan where there was nothing to hit."""
    return 100 * float(hits.mean()) if len(hits) else float("nan")
