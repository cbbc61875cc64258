"""Upright boxes, checked on rectangles whose turn is known and against sampled volumes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from proground_log.mapping.boxes import (
    OrientedBox,
    box_around,
    gap_m,
    shared_plan_m2,
    shared_volume_m3,
    upright_from_world,
)
from proground_log.streams import stream

UP = np.array([0.0, 0.0, 1.0])
ANGLES = st.floats(-3.1, 3.1)


def grid(size_m: tuple[float, float, float]) -> np.ndarray:
    """Points 1 cm apart or less that fill a box about the origin."""
    axes = [np.linspace(-side / 2, side / 2, 41) for side in size_m]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def box(
    centre_m: tuple[float, float, float], extent_m: tuple[float, float, float], yaw_rad: float
) -> OrientedBox:
    axes = Rotation.from_euler("z", yaw_rad).as_matrix().T
    return OrientedBox(np.array(centre_m), np.array(extent_m), axes, yaw_rad)


def contains(of: OrientedBox, points_m: np.ndarray) -> np.ndarray:
    inside = np.abs((points_m - of.centre_m) @ of.axes.T) <= of.extent_m / 2
    return np.asarray(inside.all(axis=1))


@settings(max_examples=25, deadline=None)
@given(yaw_rad=ANGLES, tilt=st.sampled_from(["z", "x", "askew"]))
def test_a_turned_block_gets_its_own_box_whatever_is_up(yaw_rad: float, tilt: str) -> None:
    turned = grid((2.0, 0.6, 0.9)) @ Rotation.from_euler("z", yaw_rad).as_matrix().T
    euler = {"z": (0, 0, 0), "x": (0, 90, 0), "askew": (20, -50, 70)}[tilt]
    world_from_upright = Rotation.from_euler("xyz", euler, degrees=True).as_matrix()
    points_m = turned @ world_from_upright.T + (1.0, -2.0, 3.0)
    up = world_from_upright @ UP
    found = box_around(points_m, up)
    np.testing.assert_allclose(found.centre_m, (1.0, -2.0, 3.0), atol=1e-3)
    np.testing.assert_allclose(found.extent_m, [2.0, 0.6, 0.9], rtol=0.01)
    np.testing.assert_allclose(found.axes @ found.axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(found.axes) == pytest.approx(1)
    np.testing.assert_allclose(found.axes[2], up, atol=1e-9)
    long = world_from_upright @ Rotation.from_euler("z", yaw_rad).as_matrix()[:, 0]
    assert abs(found.axes[0] @ long) == pytest.approx(1, abs=1e-4)
    assert -np.pi / 2 < found.yaw_rad <= np.pi / 2
    if tilt == "z":
        assert np.cos(2 * (found.yaw_rad - yaw_rad)) == pytest.approx(1, abs=1e-4)


def test_strays_hardly_stretch_a_box_and_one_point_has_one() -> None:
    points_m = np.concatenate([grid((1.0, 0.5, 0.5)), [[0, 0, 9.0]]])
    assert box_around(points_m, UP).extent_m[2] < 0.51
    assert (box_around(np.ones((1, 3)), UP).extent_m > 0).all()


def test_upright_leaves_a_world_on_z_alone_and_turns_others_onto_it() -> None:
    np.testing.assert_array_equal(upright_from_world(UP), np.eye(3))
    for up in np.concatenate([np.eye(3), -np.eye(3)]):
        upright = upright_from_world(up)
        np.testing.assert_allclose(upright @ up, UP, atol=1e-9)
        assert np.linalg.det(upright) == pytest.approx(1)


@settings(max_examples=30, deadline=None)
@given(yaws=st.tuples(ANGLES, ANGLES), seed=st.integers(0, 999))
def test_overlap_and_gap_are_those_of_sampled_points(yaws: tuple[float, float], seed: int) -> None:
    draw = stream(seed, "boxes")
    first = box((0.0, 0.0, 0.0), (1.0, 0.6, 0.8), yaws[0])
    x, y, z = draw.uniform(-1, 1, 3)
    second = box((float(x), float(y), float(z)), (0.8, 0.5, 0.4), yaws[1])
    inside = draw.uniform(-0.5, 0.5, (40000, 3)) * first.extent_m @ first.axes + first.centre_m
    share = contains(second, inside).mean()
    assert shared_volume_m3(first, second) == pytest.approx(share * first.volume_m3, abs=0.01)
    # OpenCV cuts the plans with 32-bit floats.
    assert shared_volume_m3(first, second) == pytest.approx(
        shared_volume_m3(second, first), abs=1e-4
    )
    assert shared_plan_m2(first, second) == pytest.approx(shared_plan_m2(second, first), abs=1e-4)
    # The distance from a point to a box is exact; that of boxes is its least over the surface.
    faces = grid((1.0, 1.0, 1.0)) * first.extent_m @ first.axes + first.centre_m
    outside = np.abs((faces - second.centre_m) @ second.axes.T) - second.extent_m / 2
    least_m = np.linalg.norm(outside.clip(min=0), axis=1).min()
    assert gap_m(first, second) == pytest.approx(least_m, abs=0.02)
    assert gap_m(first, second) == pytest.approx(gap_m(second, first), abs=1e-4)
