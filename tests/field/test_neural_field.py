"""The field's place in space: cells are cubes in metres, whatever the shape of the bounds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from proground_log.bounds import Bounds
from proground_log.field.config import FieldConfig, SemanticSpace
from proground_log.field.encodings import hash_grid_torch
from proground_log.field.neural_field import LEAST_POINTS, NeuralField, log2_rows_for
from proground_log.streams import stream

FLAT = Bounds((-3.0, 1.0, -0.5), (5.0, 5.0, 0.5))
CENTER_M = np.array([1.03, 3.02, 0.01])


def field_of(config: FieldConfig) -> NeuralField:
    """A field over the flat box whose table is random and large."""
    field = NeuralField(config, FLAT, seed=0)
    values = stream(0, "test table").uniform(-1, 1, tuple(field.table.shape))
    with torch.no_grad():
        field.table.copy_(torch.from_numpy(values.astype(np.float32)))
    return field


def features_at(field: NeuralField, points_m: np.ndarray) -> np.ndarray:
    points, inside = field.normalise(torch.from_numpy(points_m.astype(np.float32)))
    assert inside.all()
    with torch.no_grad():
        return field.hash_features(points).numpy()


@pytest.mark.parametrize("axis", range(3))
def test_cells_have_the_same_length_along_every_axis(axis: int) -> None:
    """Along a line features are linear within a cell: find where their slope changes."""
    config = FieldConfig(log2_rows=16, levels=1, base_resolution=32)
    field = field_of(config)
    along_m = np.linspace(FLAT.lower_m[axis], FLAT.upper_m[axis], 4000)
    points_m = np.tile(CENTER_M, (len(along_m), 1))
    points_m[:, axis] = along_m
    slopes = np.diff(features_at(field, points_m), axis=0) / np.diff(along_m)[:, None]
    changes = np.flatnonzero(np.abs(np.diff(slopes, axis=0)).max(axis=1) > 0.1)
    # The interval that a border lies in has a slope between its neighbours': two changes.
    borders_m = along_m[changes[np.diff(changes, prepend=-9) > 1]]
    # 32 corners span the longest side, and the first cell begins half a cell before it.
    cell_m = 8 / 31
    expected_m = np.arange(0.5, FLAT.size_m[axis] / cell_m) * cell_m + FLAT.lower_m[axis]
    np.testing.assert_allclose(borders_m, expected_m, atol=2 * np.diff(along_m)[0])


def test_hash_features_are_those_of_a_cube_with_the_longest_side() -> None:
    field = field_of(FieldConfig(log2_rows=12, levels=8, voxel_m=0.05))
    points_m = stream(1, "test points").uniform(FLAT.lower_m, FLAT.upper_m, (500, 3))
    in_cube = torch.from_numpy((points_m - FLAT.lower_m) / 8.0)
    expected = hash_grid_torch(in_cube, field.table.detach().double(), field.layout)
    found = features_at(field, points_m)
    np.testing.assert_allclose(found, expected.numpy(), atol=2e-4)
    assert found.shape == (500, field.hash_width) == (500, 16)


def test_features_are_continuous_up_to_the_bounds_and_equally_steep_along_every_axis() -> None:
    field = field_of(FieldConfig(log2_rows=12, levels=8, voxel_m=0.05))
    start_m = stream(2, "test points").uniform(
        FLAT.lower_m, np.array(FLAT.upper_m) - 2e-3, (3000, 3)
    )
    start_m[:8] = (
        np.array(np.meshgrid(*zip(FLAT.lower_m, FLAT.upper_m, strict=True))).reshape(3, 8).T
    )
    start_m[:8] = np.minimum(start_m[:8], np.array(FLAT.upper_m) - 2e-3)
    at_start = features_at(field, start_m)
    steepest = []
    for axis in range(3):
        moved_m = start_m.copy()
        moved_m[:, axis] += 1e-3
        change = np.abs(features_at(field, moved_m) - at_start).reshape(3000, 8, 2).max(axis=2)
        # Values of -1 to 1 at the corners: at most 2 a cell.
        most = 2 * field.layout.scales / 8.0 * 1e-3
        assert (change <= most * 1.01 + 1e-5).all()
        steepest.append(change.mean(axis=0))
    np.testing.assert_allclose(steepest[1], steepest[0], rtol=0.3)
    np.testing.assert_allclose(steepest[2], steepest[0], rtol=0.3)


def test_rows_of_the_hash_grid_grow_with_the_volume_within_limits() -> None:
    def rows(x_m: float, y_m: float, z_m: float) -> int:
        return log2_rows_for(Bounds((0.0, 0.0, 0.0), (x_m, y_m, z_m)))

    assert rows(1, 1, 1) == 16
    assert rows(10, 5, 3) == 16
    assert rows(20, 10, 3) == 18
    assert rows(100, 100, 10) == 18
    assert NeuralField(FieldConfig(levels=4), FLAT, 0).layout.log2_rows == 16


@pytest.mark.parametrize("count", [*range(1, 13), LEAST_POINTS + 1])
def test_few_points_get_the_same_answer_at_any_number_of_threads(count: int) -> None:
    field = field_of(FieldConfig(log2_rows=10, levels=4))
    points = torch.from_numpy(stream(2, "test points").random((count, 3), dtype=np.float32))
    threads, answers = torch.get_num_threads(), []
    try:
        for number in (1, 2, 4):
            torch.set_num_threads(number)
            with torch.no_grad():
                sdf, color, features = field.with_features(points, SemanticSpace())
                answer = [*field(points), field.sdf(points), sdf, color, *vars(features).values()]
            assert all(len(part) == count for part in answer)
            answers.append([part.numpy().tobytes() for part in answer])
    finally:
        torch.set_num_threads(threads)
    assert answers[1] == answers[0]
    assert answers[2] == answers[0]
