"""The online mapper: one frame after the other into the field (paper 4.3, Eq. 2).

It knows no clock, no file and no viewer.
"""

from __future__ import annotations

import copy
import hashlib
from dataclasses import asdict

import numpy as np
import torch
from torch import Tensor

from proground_log.bounds import Bounds
from proground_log.events import Counts, Event, KeyframeInserted, SemanticScores
from proground_log.field.losses import color_loss, depth_loss, sdf_losses, smoothness_loss
from proground_log.field.neural_field import NeuralField
from proground_log.field.rendering import before_surface, composite, sdf_weights
from proground_log.field.sampling import sample_depths
from proground_log.frame import Frame
from proground_log.mapping.mapper import StepResult
from proground_log.mapping.neural.config import NeuralConfig
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.observed import ObservedSurface
from proground_log.mapping.neural.optimiser import (
    ADAM_BETAS,
    restore_training,
    training_state,
    under,
)
from proground_log.mapping.neural.replay_buffer import RaySamples, ReplayBuffer, ray_samples
from proground_log.mapping.neural.semantic_learner import SemanticLearner
from proground_log.mapping.neural.semantic_map import SemanticMap
from proground_log.perception.description import PerceptionDescription
from proground_log.streams import stream

TABLE_EPSILON = 1e-15
AVERAGE_EVERY = 10
"""Steps between two moves of the averaged field."""
DECODER_WEIGHT_DECAY = 1e-6


class OnlineMapper:
    """Learns the field from a stream of posed frames, remembering the past in a replay buffer.

    `field` is what the optimiser moves, `averaged` the running mean of what it has been of late:
    the map. Few rays a step make the former tremble; semantics are learnt on features that stand
    still. `pixels` are the flat numbers of the newest frame's usable pixels.

    Args:
        config: settings.
        bounds: the box to map; what lies outside is masked.
        seed: of every random draw.
        device: "cpu" or "cuda".
        perception: what the frames' regions mean; None where they have none.
    """

    def __init__(
        self,
        config: NeuralConfig,
        bounds: Bounds,
        seed: int,
        device: str,
        perception: PerceptionDescription | None = None,
    ) -> None:
        self.config, self.bounds, self.seed = config, bounds, seed
        self.device = torch.device(device)
        self.field = NeuralField(config.field, bounds, seed).to(self.device)
        self.buffer = ReplayBuffer(config.buffer.capacity, config.buffer.place_m)
        self.observed = ObservedSurface(bounds)
        decoders = list(self.field.decoders.parameters())
        self.optimiser = torch.optim.Adam(
            [
                {"params": [self.field.table], "eps": TABLE_EPSILON},
                {"params": decoders, "weight_decay": DECODER_WEIGHT_DECAY},
            ],
            lr=config.learning_rate,
            betas=ADAM_BETAS,
            fused=True,
        )
        self.averaged = copy.deepcopy(self.field).requires_grad_(False)
        self.semantics: SemanticLearner | None = None
        if perception is not None and config.semantics.enabled:
            self.semantics = SemanticLearner(config, perception, self.averaged, seed)
        self._frame: Frame | None = None
        self.pixels = np.zeros(0, np.int64)
        self._iteration = 0
        self._steps = 0

    @property
    def description(self) -> PerceptionDescription | None:
        """What its meaning is of; None where it learns none."""
        return None if self.semantics is None else self.semantics.description

    def insert(self, frame: Frame, *, is_keyframe: bool = True) -> tuple[Event, ...]:
        """Make `frame` the current one; samples of a keyframe are remembered."""
        self._frame, self._iteration = frame, 0
        self.observed.add(frame)
        self.pixels = self._usable_pixels(frame)
        if self.semantics is not None:
            self.semantics.insert(frame, self.pixels)
        if not is_keyframe or not len(self.pixels):
            return ()
        random = stream(self.seed, "buffer", frame.index)
        count = min(self.config.buffer.keyframe_samples, len(self.pixels))
        chosen = np.sort(random.choice(self.pixels, size=count, replace=False))
        evicted = self.buffer.insert(frame.index, ray_samples(frame, chosen), random)
        return (KeyframeInserted(frame.index, inserted=count, evicted=evicted),)

    def insert_regions(self, frame: Frame) -> None:
        """Learn what a frame means that was inserted before it was known."""
        if self.semantics is not None:
            self.semantics.insert(frame, self._usable_pixels(frame))

    def _usable_pixels(self, frame: Frame) -> np.ndarray:
        """Flat numbers of the pixels with depth and colour, within the bounds."""
        candidates = np.flatnonzero((frame.depth_m > 0) & frame.color_valid)
        points_m = ray_samples(frame, candidates).points_m()
        return candidates[self.bounds.contains(points_m)]

    def steps(self, count: int) -> list[StepResult]:
        """Do so many steps; none where neither the frame nor the buffer has a sample."""
        results: list[StepResult] = []
        while len(results) < count and (result := self.step()) is not None:
            results.append(result)
        return results

    def step(self) -> StepResult | None:
        """One optimisation step; None where neither the frame nor the buffer has a sample."""
        if self._frame is None or not (len(self.pixels) or len(self.buffer)):
            return None
        rays, current, draws = self._draw_rays()
        sampling = self.config.sampling
        random = stream(self.seed, "jitter", self._frame.index, self._iteration)
        samples = sampling.uniform + sampling.near_surface
        jitter = random.random((len(rays), samples), dtype=np.float32)
        corner = random.random(3, dtype=np.float32)
        depths_m = sample_depths(
            rays.depth_m,
            uniform=sampling.uniform,
            near_surface=sampling.near_surface,
            near_m=sampling.near_m,
            range_m=sampling.range_m,
            jitter=jitter,
        )
        terms = self._losses(rays, depths_m, current, corner)
        weights = self.config.weights
        total = torch.stack([getattr(weights, name) * term for name, term in terms.items()]).sum()
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        self.optimiser.step()
        self._average()
        *values, sum_of_terms = torch.stack([*terms.values(), total]).detach().cpu().tolist()
        losses = dict(zip(terms, values, strict=True))
        if self.semantics is not None:
            semantic = self.semantics.step(self._frame.index, self._iteration)
            if semantic is not None:
                losses |= semantic.losses
                sum_of_terms += semantic.total
                draws += semantic.draws
        self._iteration += 1
        digest = hashlib.sha256()
        for draw in (*draws, jitter, corner):
            digest.update(draw.tobytes())
        return StepResult({**losses, "total": sum_of_terms}, digest.hexdigest())

    def _average(self) -> None:
        """Let the averaged field follow; at first it is close behind, so that it starts well."""
        if self._steps % AVERAGE_EVERY == 0:
            share = max(self.config.average_share, 2 / (self._steps // AVERAGE_EVERY + 2))
            with torch.no_grad():
                pairs = zip(self.averaged.parameters(), self.field.parameters(), strict=True)
                for averaged, newest in pairs:
                    averaged.lerp_(newest, share)
        self._steps += 1

    def _draw_rays(self) -> tuple[RaySamples, int, list[np.ndarray]]:
        """The step's rays, those of the current frame first, their number, and the draws."""
        assert self._frame is not None
        sampling = self.config.sampling
        random = stream(self.seed, "rays", self._frame.index, self._iteration)
        current = sampling.rays
        if not len(self.pixels):
            current = 0
        elif len(self.buffer):
            current = round(sampling.rays * sampling.current_share)
        draws = []
        rays = RaySamples.empty()
        if current:
            draws.append(random.integers(0, len(self.pixels), size=current))
            rays = ray_samples(self._frame, self.pixels[draws[-1]])
        if current < sampling.rays:
            draws.append(random.integers(0, len(self.buffer), size=sampling.rays - current))
            rays = RaySamples.concatenate(rays, self.buffer.take(draws[-1]))
        return rays, current, draws

    def _losses(
        self, rays: RaySamples, depths_m: np.ndarray, current: int, corner: np.ndarray
    ) -> dict[str, Tensor]:
        count, samples = depths_m.shape
        tr_m = self.config.field.truncation_m
        to = self.device
        z_m = torch.from_numpy(depths_m).to(to)
        origins_m = torch.from_numpy(rays.origins_m).to(to)
        directions = torch.from_numpy(rays.directions).to(to)
        observed_m = torch.from_numpy(rays.depth_m).to(to)
        observed_color = torch.from_numpy(rays.colors).to(to).float() / 255
        points_m = origins_m[:, None] + directions[:, None] * z_m[..., None]
        points, inside = self.field.normalise(points_m.reshape(-1, 3))
        inside = inside.reshape(count, samples)
        lattice = self._lattice(corner)
        # One call for both: each costs a gradient of the size of the whole table.
        hashed = self.field.hash_features(torch.cat([points, lattice]))
        sdf, color = self.field.decode(points, hashed[: len(points)])
        sdf = sdf.reshape(count, samples)
        weights = sdf_weights(sdf, inside & before_surface(sdf.detach(), z_m, tr_m))
        rendered = composite(weights, color.reshape(count, samples, 3))
        rendered_m = (weights * z_m).sum(dim=1)
        ray_weights = torch.full((count,), self.config.beta, device=to)
        ray_weights[:current] = 1.0
        sdf_term, free_term = sdf_losses(sdf, z_m, observed_m, inside, ray_weights, tr_m)
        return {
            "rgb": color_loss(rendered, observed_color, ray_weights),
            "depth": depth_loss(rendered_m, observed_m, ray_weights),
            "sdf": sdf_term,
            "free_space": free_term,
            "smoothness": smoothness_loss(
                hashed[len(points) :].unflatten(0, (self.config.smoothness_points,) * 3)
            ),
        }

    def _lattice(self, corner: np.ndarray) -> Tensor:
        """A small lattice at a random place in the bounds, [P * P * P, 3], normalised."""
        points = self.config.smoothness_points
        spacing = torch.from_numpy(
            (self.config.smoothness_spacing_m / self.bounds.size_m).astype(np.float32)
        )
        extent = spacing * (points - 1)
        start = torch.from_numpy(corner) * (1 - extent).clamp_min(0)
        axis = torch.arange(points, dtype=torch.float32)
        grid = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1)
        return (start + grid * spacing).clamp(0, 1).reshape(-1, 3).to(self.device)

    def scores(self, frame_index: int) -> SemanticScores | None:
        """How well the heads give back what the regions say."""
        return None if self.semantics is None else self.semantics.scores(frame_index)

    def counts(self) -> Counts:
        """What the replay buffer and the memory of meaning hold."""
        semantics = None if self.semantics is None else asdict(self.semantics.statistics())
        return {"buffer": asdict(self.buffer.statistics()), "semantics": semantics}

    def finish(self) -> None:
        """Nothing is left to do: the map is the field as it stands."""

    def map(self) -> NeuralMap:
        """The map so far."""
        learner, semantics = self.semantics, None
        if learner is not None:
            semantics = SemanticMap(learner.heads, learner.description)
        return NeuralMap(self.averaged, self.observed, semantics)

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame builds on, by name: "field/...", "optimiser/...", ...

        Views, not copies: good until the next step or frame.
        """
        state = training_state(self.field, self.optimiser)
        state |= {f"buffer/{name}": array for name, array in self.buffer.state().items()}
        state["observed/voxels"] = np.packbits(self.observed.voxels)
        for name, parameter in self.averaged.named_parameters():
            state[f"averaged/{name}"] = parameter.detach().cpu().numpy()
        state["steps"] = np.array([self._steps])
        if self.semantics is not None:
            state |= {f"semantics/{name}": a for name, a in self.semantics.state().items()}
        return state

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned, after the last step of a frame."""
        restore_training(self.field, self.optimiser, state)
        self.buffer.restore(under("buffer", state))
        voxels = np.unpackbits(state["observed/voxels"], count=self.observed.voxels.size)
        self.observed.voxels = voxels.reshape(self.observed.voxels.shape).astype(bool)
        averaged = under("averaged", state)
        with torch.no_grad():
            for name, parameter in self.averaged.named_parameters():
                parameter.copy_(torch.from_numpy(averaged[name]))
        self._steps = state["steps"].item()
        if self.semantics is not None:
            self.semantics.restore(under("semantics", state))
        self._frame = None
