"""The map on disk: all that rendering, meshing and querying need, in one safetensors file."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from proground_log.field.config import FieldConfig
from proground_log.field.neural_field import NeuralField
from proground_log.field.view import EmptySpace, render_view
from proground_log.files import require_file, written_whole
from proground_log.mapping.observed import BLOCK_M, ObservedSurface

MAP_VERSION = "1"
NEAR_M = 0.05
"""Where a rendered ray begins, along z."""


@dataclass(frozen=True)
class NeuralMap:
    """A finished map.

    Args:
        field: the neural field.
        observed: where its surface was seen.
    """

    field: NeuralField
    observed: ObservedSurface

    def render(
        self, camera: Camera, world_from_camera: np.ndarray, *, near_m: float = NEAR_M
    ) -> tuple[np.ndarray, np.ndarray]:
        """Colour and depth as a camera would see the map; see `field.view.render_view`."""
        empty = EmptySpace(
            self.observed.distance_m(),
            np.array(self.observed.bounds.lower_m),
            BLOCK_M,
            self.field.table.device,
        )
        return render_view(self.field, empty, camera, world_from_camera, near_m=near_m)

    def sizes_bytes(self) -> dict[str, int]:
        """Size of each part of the map."""
        decoders = sum(p.nbytes for p in self.field.decoders.parameters())
        return {
            "hash grid": self.field.table.nbytes,
            "decoders": decoders,
            "observed surface": (self.observed.voxels.size + 7) // 8,
        }


def save_map(path: Path, content: NeuralMap) -> None:
    """Write a map, whole or not at all; the same map gives the same bytes."""
    field = content.field
    tensors = {
        f"field/{name}": p.detach().cpu().numpy() for name, p in sorted(field.named_parameters())
    }
    tensors["observed/voxels"] = np.packbits(content.observed.voxels)
    header = {
        "version": MAP_VERSION,
        "field": dataclasses.asdict(field.config),
        "bounds": dataclasses.asdict(field.bounds),
    }
    with written_whole(path) as temporary:
        # One entry: safetensors writes several in any order.
        save_file(tensors, temporary, {"proground.map": json.dumps(header)})


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
    with torch.no_grad():
        for name, parameter in field.named_parameters():
            parameter.copy_(torch.from_numpy(tensors[f"field/{name}"]))
    observed = ObservedSurface(bounds)
    bits = np.unpackbits(tensors["observed/voxels"], count=observed.voxels.size)
    observed.voxels = bits.reshape(observed.voxels.shape).astype(bool)
    return NeuralMap(field.to(device), observed)
