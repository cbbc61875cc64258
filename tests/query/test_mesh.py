"""The mesh is that of the lattice; a map that has no surface yet gives an empty one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.measure import marching_cubes

from proground_log.bounds import Bounds
from proground_log.field.config import FieldConfig
from proground_log.field.neural_field import NeuralField
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.observed import ObservedSurface
from proground_log.query import mesh as surface
from proground_log.query.mesh import extract_mesh
from proground_log.streams import stream

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


@pytest.mark.parametrize("at_once", [surface.POINTS_AT_ONCE, 97])
def test_the_mesh_is_that_of_the_whole_lattice_however_it_is_asked(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surface, "POINTS_AT_ONCE", at_once)
    observed = ObservedSurface(BOUNDS)
    observed.voxels[:] = True
    field = NeuralField(FieldConfig(log2_rows=10, levels=2), BOUNDS, seed=0)
    with torch.no_grad():
        values = stream(0, "table").normal(size=field.table.shape).astype(np.float32)
        field.table.copy_(torch.from_numpy(values))
        axis = torch.linspace(0, 1, 11)
        lattice = torch.cartesian_prod(axis, axis, axis)
        sdf = field.sdf(lattice).reshape(11, 11, 11).numpy()
    vertices, faces, _, _ = marching_cubes(sdf, 0.0, gradient_direction="descent")
    mesh = extract_mesh(NeuralMap(field, observed), 0.1)
    assert len(mesh.faces) > 100
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertices_m, vertices / 10, atol=1e-5)
