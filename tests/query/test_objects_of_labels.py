"""Objects of a small table with things on it, whose evidence is known vertex by vertex."""

from __future__ import annotations

import numpy as np
import pytest

from proground_log.mapping.boxes import box_around
from proground_log.mapping.objects import SceneObject
from proground_log.query.mesh import Mesh
from proground_log.query.objects import object_of_vertices
from proground_log.query.objects_of_labels import (
    LEAST_SPOT_M2,
    objects_of_labels,
    without_duplicates,
)
from proground_log.query.settling import STIFFNESS_M, settle_labels
from proground_log.streams import stream
from tests.query.sheets import UP, patch, sheet

VOXEL_M = 0.04
PROMPTS = ("table", "cup")


def table_and_cup(lead: float) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """A table, and 5 x 5 vertices on it that are more cup than table by so many logits."""
    mesh = sheet(30, 30, VOXEL_M)
    cup = patch(slice(10, 15), slice(10, 15), (30, 30))
    logits = np.tile(np.array([2.0, -2.0]), (900, 1))
    logits[cup] = (1.0, 1.0 + lead)
    return mesh, logits, cup


def test_what_is_surely_something_else_stays_and_a_speck_gives_way() -> None:
    mesh, sure, cup = table_and_cup(6.0)
    np.testing.assert_array_equal(settle_labels(sure, mesh.faces, VOXEL_M), cup.astype(int))
    _, unsure, _ = table_and_cup(0.3)
    assert not settle_labels(unsure, mesh.faces, VOXEL_M).any()


def test_a_patch_gives_way_just_where_its_border_costs_more_than_its_lead() -> None:
    mesh, _, cup = table_and_cup(1.0)
    ends = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]]), axis=1)
    ends = np.unique(np.concatenate([ends, np.sort(mesh.faces[:, [2, 0]], axis=1)]), axis=0)
    border = np.count_nonzero(cup[ends[:, 0]] != cup[ends[:, 1]])
    critical = STIFFNESS_M * border / (cup.sum() * VOXEL_M)
    for factor, stays in ((0.99, False), (1.01, True)):
        _, logits, _ = table_and_cup(factor * critical)
        assert settle_labels(logits, mesh.faces, VOXEL_M).any() == stays


def test_noise_of_single_vertices_is_gone_and_what_was_there_before_is_found() -> None:
    mesh, logits, cup = table_and_cup(6.0)
    noisy = logits + stream(0, "noise").normal(0, 2.0, logits.shape)
    assert (noisy.argmax(axis=1) != cup).sum() > 40
    assert (settle_labels(noisy, mesh.faces, VOXEL_M) != cup).sum() <= 3


def test_objects_are_what_their_vertices_say() -> None:
    mesh, logits, cup = table_and_cup(6.0)
    background = np.where(patch(slice(0, 30), slice(20, 30), (30, 30)), 0.99, 0.02)
    table, found_cup = objects_of_labels(mesh, logits, background, PROMPTS, UP, VOXEL_M)
    assert (table.label, found_cup.label) == PROMPTS
    np.testing.assert_array_equal(found_cup.vertices, np.flatnonzero(cup))
    np.testing.assert_allclose(found_cup.box.centre_m, (0.48, 0.48, 0), atol=1e-3)
    np.testing.assert_allclose(found_cup.box.extent_m[:2], 4 * VOXEL_M, atol=1e-3)
    assert (background[table.vertices] < 0.5).all()
    # Nobody knows who saw them; what they are can be asked of their vertices.
    assert table.views is found_cup.views is None
    np.testing.assert_array_equal(found_cup.witnesses, found_cup.vertices)
    numbers = object_of_vertices([table, found_cup], len(cup))
    np.testing.assert_array_equal(numbers == 1, cup)
    assert (numbers[background > 0.5] == -1).all()
    # A text that no object is of only takes vertices away.
    logits = np.concatenate([logits, np.where(cup, 20.0, -9.0)[:, None]], axis=1)
    (alone,) = objects_of_labels(mesh, logits, background, PROMPTS, UP, VOXEL_M)
    assert alone.label == "table"


def test_two_things_of_one_prompt_with_background_between_are_two() -> None:
    mesh = sheet(30, 30, VOXEL_M)
    logits = np.tile(np.array([2.0, -2.0]), (900, 1))
    for gap, things in ((1, 1), (6, 2)):
        between = patch(slice(0, 30), slice(12, 12 + gap), (30, 30))
        background = np.where(between, 0.999, 0.02)
        assert len(objects_of_labels(mesh, logits, background, PROMPTS, UP, VOXEL_M)) == things


def test_what_is_small_or_hardly_relevant_is_no_object() -> None:
    mesh = sheet(30, 30, VOXEL_M)
    shape = (30, 30)
    side = int(np.sqrt(LEAST_SPOT_M2) / VOXEL_M)
    speck = patch(slice(0, side), slice(0, side), shape)
    background = np.where(speck | patch(slice(10, 20), slice(10, 20), shape), 1e-6, 1 - 1e-6)
    unlikely = np.tile(np.array([-5.0, -9.0]), (900, 1))
    likely = unlikely + 6
    (thing,) = objects_of_labels(mesh, likely, background, PROMPTS, UP, VOXEL_M)
    assert len(thing.vertices) == 100
    assert objects_of_labels(mesh, unlikely, background, PROMPTS, UP, VOXEL_M) == []


def thing_at(corner_m: tuple[float, float, float], size_m: float, score: float) -> SceneObject:
    axis = np.linspace(0, size_m, 8)
    points_m = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + corner_m
    count = int(1000 * size_m)
    vertices, middle_m = np.arange(count), points_m.mean(axis=0)
    extent_m = points_m[0], points_m[-1]
    box = box_around(points_m, UP)
    return SceneObject("cup", middle_m, *extent_m, score, vertices, box, vertices)


@pytest.mark.parametrize(("shift_m", "kept"), [(0.0, 1), (0.1, 1), (0.8, 2), (3.0, 2)])
def test_a_part_within_a_larger_thing_is_no_thing_of_its_own(shift_m: float, kept: int) -> None:
    small, large = thing_at((0.4 + shift_m, 0.4, 0.4), 0.4, 0.9), thing_at((0, 0, 0), 1.0, 0.5)
    found = without_duplicates([small, large])
    assert len(found) == kept
    assert found[-1] is large
