"""A map that has no surface yet gives an empty mesh, and no file."""

from __future__ import annotations

import pytest
import torch

from proground_log.bounds import Bounds
from proground_log.field.config import FieldConfig
from proground_log.field.neural_field import NeuralField
from proground_log.mapping.map_file import NeuralMap
from proground_log.mapping.observed import ObservedSurface
from proground_log.query.surface import extract_mesh

BOUNDS = Bounds((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


@pytest.mark.parametrize("seen", [0, 1])
def test_a_map_without_a_surface_has_no_mesh(seen: int) -> None:
    observed = ObservedSurface(BOUNDS)
    observed.voxels[:seen, :seen, :seen] = True
    field = NeuralField(FieldConfig(log2_rows=10, levels=2), BOUNDS, seed=0)
    with torch.no_grad():
        field.decoders.geometry_out.zero_()
    mesh = extract_mesh(NeuralMap(field, observed), 0.3)
    assert len(mesh.vertices_m) == len(mesh.faces) == 0
