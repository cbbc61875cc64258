"""The map on disk: all that rendering, meshing and querying need, in one safetensors file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from proground_log.field.config import FieldConfig, SemanticSpace
from proground_log.field.encodings import HashGridLayout
from proground_log.field.neural_field import NeuralField
from proground_log.field.semantic_heads import PointFeatures, SemanticHeads
from proground_log.field.view import EmptySpace, RenderedView, render_view
from proground_log.files import require_file, written_whole
from proground_log.mapping.observed import BLOCK_M, ObservedSurface
from proground_log.mapping.semantic_map import SemanticMap, Semantics
from proground_log.perception.description import PerceptionDescription

MAP_VERSION = "2"
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

    def render(
        self,
        camera: Camera,
        world_from_camera: np.ndarray,
        *,
        near_m: float = NEAR_M,
        antialias: bool = False,
    ) -> RenderedView:
        """The map as a camera would see it; with features for its semantics where it has any."""
        empty = EmptySpace(
            self.observed.distance_m(),
            np.array(self.observed.bounds.lower_m),
            BLOCK_M,
            self.field.table.device,
        )
        space = self.semantics.heads.space if self.semantics is not None else None
        return render_view(
            self.field,
            empty,
            camera,
            world_from_camera,
            near_m=near_m,
            space=space,
            antialias=antialias,
        )

    def features_at(self, points_m: np.ndarray) -> Iterator[PointFeatures]:
        """What the semantic heads look at, at points [N, 3] in world metres, some at a time.

        The map must have semantics.
        """
        assert self.semantics is not None
        for part_m in torch.from_numpy(points_m.astype(np.float32)).split(POINTS_AT_ONCE):
            points, _ = self.field.normalise(part_m.to(self.field.table.device))
            yield self.field.with_features(points, self.semantics.heads.space)[2]

    def semantics_at(self, points_m: np.ndarray) -> Semantics:
        """What the map means at points [N, 3] in world metres; the map must have semantics.

        To compare with texts, `ask_map` is faster.
        """
        assert self.semantics is not None
        return Semantics.concatenate(list(map(self.semantics.decode, self.features_at(points_m))))

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


def save_map(path: Path, content: NeuralMap) -> None:
    """Write a map, whole or not at all; the same map gives the same bytes."""
    field = content.field
    tensors = {
        f"field/{name}": p.detach().cpu().numpy() for name, p in sorted(field.named_parameters())
    }
    tensors["field/table"], tensors["field/table_largest"] = _packed(field)
    tensors["observed/voxels"] = np.packbits(content.observed.voxels)
    header: dict[str, object] = {
        "version": MAP_VERSION,
        "field": dataclasses.asdict(field.config),
        "bounds": dataclasses.asdict(field.bounds),
    }
    if content.semantics is not None:
        heads = content.semantics.heads
        header["space"] = dataclasses.asdict(heads.space)
        for name, parameter in sorted(heads.named_parameters()):
            tensors[f"heads/{name}"] = parameter.detach().cpu().numpy()
        tensors["perception"] = np.frombuffer(content.semantics.description.to_bytes(), np.uint8)
    with written_whole(path) as temporary:
        # One entry: safetensors writes several in any order.
        temporary.write_bytes(save(tensors, {"proground.map": json.dumps(header)}))


def load_map(path: Path, device: str = "cpu") -> NeuralMap:
    """Read a map; raises a ProgroundError where the file is none."""
    require_file(path)
    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {}).get("proground.map", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ProgroundError(
            f"cannot be read as a map ({error})", where=path, todo="run the replay again"
        ) from error
    if header.get("version") != MAP_VERSION:
        raise ProgroundError(
            f"has map version {header.get('version')}, this pglog reads {MAP_VERSION}",
            where=path,
            todo="run the replay again with this version of pglog",
        )
    bounds = Bounds(*(tuple(header["bounds"][corner]) for corner in ("lower_m", "upper_m")))
    field = NeuralField(FieldConfig(**header["field"]), bounds, seed=0)
    tensors["field/table"] = _unpacked(
        tensors["field/table"], tensors["field/table_largest"], field.layout
    )
    with torch.no_grad():
        for name, parameter in field.named_parameters():
            parameter.copy_(torch.from_numpy(tensors[f"field/{name}"]))
    semantics = None
    if "space" in header:
        heads = SemanticHeads(SemanticSpace(**header["space"]), field.hash_width, seed=0)
        with torch.no_grad():
            for name, parameter in heads.named_parameters():
                parameter.copy_(torch.from_numpy(tensors[f"heads/{name}"]))
        description = PerceptionDescription.from_bytes(tensors["perception"].tobytes(), where=path)
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
