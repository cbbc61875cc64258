"""The neural map: the averaged field, where its surface was seen, and the heads of meaning."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.field.config import FieldConfig, SemanticSpace
from proground_log.field.encodings import HashGridLayout
from proground_log.field.neural_field import NeuralField
from proground_log.field.semantic_heads import PointFeatures, SemanticHeads
from proground_log.field.view import EmptySpace, render_view
from proground_log.mapping.kinds import NEURAL
from proground_log.mapping.map import Meaning, RenderedView
from proground_log.mapping.neural.grounding import (
    BLAS,
    BLOCK,
    aligned,
    background_probability,
    level_weights,
    taken_back,
    vertex_logits,
)
from proground_log.mapping.neural.observed import BLOCK_M, ObservedSurface
from proground_log.mapping.neural.semantic_map import SemanticMap, Semantics
from proground_log.mapping.objects import SceneObject
from proground_log.perception.description import PerceptionDescription

STEPS = 127
"""A feature is kept as one of so many steps to either side of 0, up to its level's largest: a
quarter of the size, at no loss that views or depth would show (measured on a house)."""
POINTS_AT_ONCE = 65536
NEAR_M = 0.05
"""Where a rendered ray begins, along z."""


@dataclass(frozen=True)
class NeuralMap:
    """A finished map.

    Args:
        field: the neural field.
        observed: where its surface was seen.
        semantics: what it means; None where the log had no regions.
    """

    field: NeuralField
    observed: ObservedSurface
    semantics: SemanticMap | None = None

    kind = NEURAL

    @property
    def bounds(self) -> Bounds:
        """The box that was mapped."""
        return self.field.bounds

    @property
    def description(self) -> PerceptionDescription | None:
        """What its meaning is of; None where it knows none."""
        return None if self.semantics is None else self.semantics.description

    def render(
        self,
        camera: Camera,
        world_from_camera: np.ndarray,
        *,
        antialias: bool = False,
        with_meaning: bool = False,
    ) -> RenderedView:
        """The map as a camera would see it; see `Map.render`."""
        empty = EmptySpace(
            self.observed.distance_m(),
            np.array(self.observed.bounds.lower_m),
            BLOCK_M,
            self.field.table.device,
        )
        space = self._meaningful.heads.space if with_meaning else None
        color, depth_m, features = render_view(
            self.field,
            empty,
            camera,
            world_from_camera,
            near_m=NEAR_M,
            space=space,
            antialias=antialias,
        )
        meaning = None if features is None else self._told(self._meaningful.decode(features))
        return RenderedView(color, depth_m, meaning)

    def signed_distance(self, points_m: np.ndarray) -> np.ndarray:
        """Signed distances, float32 [N], in truncations."""
        return self._field_at(points_m, self.field.sdf)

    def color(self, points_m: np.ndarray) -> np.ndarray:
        """Colours, float32 [N, 3] RGB in [0, 1]."""
        return self._field_at(points_m, lambda points: self.field(points)[1])

    @torch.no_grad()
    def _field_at(self, points_m: np.ndarray, ask: Callable[[Tensor], Tensor]) -> np.ndarray:
        parts = [ask(points).cpu() for points in self._normalised(points_m)]
        return torch.cat(parts).numpy()

    def _normalised(self, points_m: np.ndarray) -> Iterator[Tensor]:
        """Points [N, 3] in world metres as the field takes them, some at a time."""
        for part_m in torch.from_numpy(points_m.astype(np.float32)).split(POINTS_AT_ONCE):
            yield self.field.normalise(part_m.to(self.field.table.device))[0]

    def near_surface(self, axes_m: Sequence[np.ndarray]) -> np.ndarray:
        """Which points of a lattice are near a surface that was seen; see `Map.near_surface`."""
        return self.observed.near_lattice(axes_m)

    def seen(self, points_m: np.ndarray) -> np.ndarray | None:  # noqa: ARG002
        """None: it remembers where surface was seen, and not what was found to be free."""
        return None

    def objects(self) -> list[SceneObject] | None:
        """None: a field does not tell objects apart."""
        return None

    def elements(self) -> np.ndarray | None:
        """None: a field has meaning everywhere."""
        return None

    @torch.no_grad()
    def ask(self, points_m: np.ndarray, texts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What texts have to do with points, without ever making an embedding; see `Map.ask`.

        The semantic head and those of the detector are linear, so texts can be taken back through
        them to the features of the field: 80 numbers a point take the place of 512.
        """
        semantics = self._meaningful
        matrix = taken_back(semantics, texts)
        logits = np.empty((len(points_m), len(texts)), np.float32)
        background = []
        start = 0
        for features in self.features_at(points_m):
            scale_logits = semantics.heads.scale_logits(features).cpu().numpy()
            uncertainty = semantics.heads.uncertainty_logits(features).sigmoid().cpu().numpy()
            background.append(background_probability(scale_logits, uncertainty))
            weights = level_weights(scale_logits)[:, :, None]
            ones = np.ones((len(weights), 1), np.float32)
            codes = np.concatenate([features.space.cpu().numpy(), ones], axis=1)[:, None]
            for first in range(0, len(codes), BLOCK):
                block = slice(first, first + BLOCK)
                # Side by side the codes times the weight of each level: the product with the texts
                # adds up the levels as well.
                weighed = (weights[block] * codes[block]).reshape(-1, len(matrix))
                with BLAS.limit(limits=1):
                    np.matmul(weighed, matrix, out=logits[start : start + len(weighed)])
                start += len(weighed)
        return logits, np.concatenate(background)

    def meaning(self, points_m: np.ndarray) -> Meaning:
        """All that the heads say of points [N, 3] in world metres."""
        return self._told(self.semantics_at(points_m))

    def semantics_at(self, points_m: np.ndarray) -> Semantics:
        """What each head says of points [N, 3] in world metres."""
        parts = map(self._meaningful.decode, self.features_at(points_m))
        return Semantics.concatenate(list(parts))

    def _told(self, semantics: Semantics) -> Meaning:
        """What the heads say, in the terms that all maps share."""
        description = self._meaningful.description
        said = semantics.embeddings, semantics.scale_logits, description.heads
        return Meaning(
            logits=vertex_logits(*said, description.texts),
            background=background_probability(semantics.scale_logits, semantics.uncertainty),
            embeddings=aligned(*said),
            levels=semantics.scale_logits.argmax(axis=1).astype(np.uint8),
            uncertainty=semantics.uncertainty,
        )

    def features_at(self, points_m: np.ndarray) -> Iterator[PointFeatures]:
        """What the semantic heads look at, at points [N, 3] in world metres, some at a time."""
        space = self._meaningful.heads.space
        for points in self._normalised(points_m):
            yield self.field.with_features(points, space)[2]

    @property
    def _meaningful(self) -> SemanticMap:
        """The part that knows meaning; nobody asks a map for meaning that has none."""
        assert self.semantics is not None
        return self.semantics

    def sizes_bytes(self) -> dict[str, int]:
        """Size of each part of the map on disk."""
        decoders = sum(p.nbytes for p in self.field.decoders.parameters())
        sizes = {
            "hash grid": self.field.table.numel() + 4 * self.field.layout.levels,
            "decoders": decoders,
            "observed surface": (self.observed.voxels.size + 7) // 8,
        }
        if self.semantics is not None:
            sizes["semantic heads"] = sum(p.nbytes for p in self.semantics.heads.parameters())
            sizes["task and texts"] = len(self.semantics.description.to_bytes())
        return sizes

    def header(self) -> dict[str, Any]:
        """Settings of the field and the heads, and the bounds."""
        header: dict[str, Any] = {
            "field": dataclasses.asdict(self.field.config),
            "bounds": dataclasses.asdict(self.field.bounds),
        }
        if self.semantics is not None:
            header["space"] = dataclasses.asdict(self.semantics.heads.space)
        return header

    def tensors(self) -> dict[str, np.ndarray]:
        """The field, its table packed, the observed voxels, the heads and the description."""
        tensors = {
            f"field/{name}": p.detach().cpu().numpy()
            for name, p in sorted(self.field.named_parameters())
        }
        tensors["field/table"], tensors["field/table_largest"] = _packed(self.field)
        tensors["observed/voxels"] = np.packbits(self.observed.voxels)
        if self.semantics is not None:
            for name, parameter in sorted(self.semantics.heads.named_parameters()):
                tensors[f"heads/{name}"] = parameter.detach().cpu().numpy()
            described = self.semantics.description.to_bytes()
            tensors["perception"] = np.frombuffer(described, np.uint8)
        return tensors


def load_neural_map(
    header: Mapping[str, Any], tensors: dict[str, np.ndarray], *, where: Path, device: str
) -> NeuralMap:
    """A map of what `NeuralMap.header` and `NeuralMap.tensors` gave."""
    bounds = Bounds(*(tuple(header["bounds"][corner]) for corner in ("lower_m", "upper_m")))
    field = NeuralField(FieldConfig(**header["field"]), bounds, seed=0)
    table = _unpacked(tensors["field/table"], tensors["field/table_largest"], field.layout)
    with torch.no_grad():
        for name, parameter in field.named_parameters():
            array = table if name == "table" else tensors[f"field/{name}"]
            parameter.copy_(torch.from_numpy(array))
    semantics = None
    if "space" in header:
        heads = SemanticHeads(SemanticSpace(**header["space"]), field.hash_width, seed=0)
        with torch.no_grad():
            for name, parameter in heads.named_parameters():
                parameter.copy_(torch.from_numpy(tensors[f"heads/{name}"]))
        description = PerceptionDescription.from_bytes(tensors["perception"].tobytes(), where=where)
        semantics = SemanticMap(heads.to(device), description)
    observed = ObservedSurface(bounds)
    bits = np.unpackbits(tensors["observed/voxels"], count=observed.voxels.size)
    observed.voxels = bits.reshape(observed.voxels.shape).astype(bool)
    return NeuralMap(field.to(device), observed, semantics)


def _packed(field: NeuralField) -> tuple[np.ndarray, np.ndarray]:
    """The hash grid as int8 [rows, 2], and the largest feature of each level, float32 [levels]."""
    table, offsets = field.table.detach().cpu().numpy(), field.layout.offsets
    levels = [table[start:stop] for start, stop in pairwise(offsets)]
    largest = np.array([max(np.abs(level).max(), 1e-12) for level in levels], np.float32)
    steps = [np.rint(level / top * STEPS) for level, top in zip(levels, largest, strict=True)]
    return np.concatenate(steps).astype(np.int8), largest


def _unpacked(steps: np.ndarray, largest: np.ndarray, layout: HashGridLayout) -> np.ndarray:
    """What `_packed` kept, float32 [rows, 2]."""
    return steps * np.repeat(largest / STEPS, np.diff(layout.offsets))[:, None]
