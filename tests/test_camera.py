from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from proground_log.camera import (
    Calibration,
    Camera,
    pose_from_quaternion,
    quaternion_from_pose,
    require_rigid,
    transform,
)
from proground_log.errors import ProgroundError
from recorders.formats.seven_scenes import COLOR_CAMERA
from recorders.formats.tum import RIGS

unit = st.floats(-1.0, 1.0)
lenses = st.sampled_from(
    [
        (),
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (-0.06, 0.0, 0.0, 0.0, 0.0),
        (0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
        (0.1, -0.05, 0.002, -0.001, 0.01),
        (0.1, -0.05, 0.002, -0.001, 0.01, 0.02, -0.01, 0.005),
        (0.1, -0.02, 0.01, -0.004),
        (0.0, 0.0, 0.0, 0.0),
    ]
)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    width, height = draw(st.integers(2, 40)), draw(st.integers(2, 30))
    # Narrow enough for these lenses to be one to one up to the corners.
    focal = draw(st.floats(1.0, 3.0)) * max(width, height)
    cx, cy = (draw(st.floats(0.4, 0.6)) * size for size in (width, height))
    return Camera(width, height, focal, 1.01 * focal, cx, cy, draw(lenses))


@st.composite
def quaternions(draw: st.DrawFn) -> np.ndarray:
    quaternion = np.array([draw(unit) for _ in range(4)])
    norm = np.linalg.norm(quaternion)
    assume(norm > 0.1)
    return quaternion / norm


def pixel_centres(camera: Camera) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([columns, rows], axis=-1).reshape(-1, 2) + 0.5


@settings(max_examples=60, deadline=None)
@given(cameras(), st.floats(0.1, 20.0))
def test_a_depth_image_projects_onto_its_own_pixels(camera: Camera, depth_m: float) -> None:
    points = camera.unproject(np.full((camera.height, camera.width), depth_m, np.float32))
    assert points.shape == (camera.height, camera.width, 3)
    np.testing.assert_allclose(points[..., 2], depth_m, rtol=1e-6)
    pixels = camera.project(points.reshape(-1, 3).astype(np.float64))
    np.testing.assert_allclose(pixels, pixel_centres(camera), atol=1e-4)


@pytest.mark.parametrize("camera", [*(rig.camera for rig in RIGS.values()), COLOR_CAMERA])
def test_the_real_lenses_are_inverted_up_to_the_corners(camera: Camera) -> None:
    pixels = camera.project(camera.directions.reshape(-1, 3).astype(np.float64))
    np.testing.assert_allclose(pixels, pixel_centres(camera), atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(cameras())
def test_projection_is_that_of_opencv(camera: Camera) -> None:
    points = camera.directions.reshape(-1, 3).astype(np.float64) * 2.5
    k, lens = camera.k_integer_centres, np.array(camera.distortion or [0.0] * 5)
    project = cv2.fisheye.projectPoints if len(lens) == 4 else cv2.projectPoints
    still = np.zeros((3, 1))
    expected, _ = project(points[:, None], still, still, k, lens)
    np.testing.assert_allclose(camera.project(points) - 0.5, expected.reshape(-1, 2), atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(cameras(), st.integers(1, 4))
def test_a_scaled_camera_sees_the_same_rays(camera: Camera, factor: int) -> None:
    scaled = camera.scaled_to_width(factor * camera.width)
    assert (scaled.width, scaled.height) == (factor * camera.width, factor * camera.height)
    points = camera.directions.reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(scaled.project(points), factor * camera.project(points), atol=1e-6)
    assert camera.scaled_to_width(camera.width) == camera


def test_scaling_keeps_at_least_one_row() -> None:
    assert Camera(100, 2, 90.0, 90.0, 50.0, 1.0).scaled_to_width(10).height == 1


def test_whole_number_centres_are_half_a_pixel_off() -> None:
    camera = Camera.from_integer_centres(640, 480, 500.0, 501.0, 319.5, 239.5)
    assert (camera.cx, camera.cy) == (320.0, 240.0)
    expected = [[500.0, 0.0, 319.5], [0.0, 501.0, 239.5], [0.0, 0.0, 1.0]]
    np.testing.assert_array_equal(camera.k_integer_centres, expected)
    # The ray through the image's middle, between four pixels, is the optical axis.
    np.testing.assert_allclose(camera.project(np.array([[0.0, 0.0, 1.0]])), [[320.0, 240.0]])


def test_pinhole_takes_the_distortion_out() -> None:
    camera = Camera(8, 6, 7.0, 7.0, 4.0, 3.0, (0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera.pinhole() == Camera(8, 6, 7.0, 7.0, 4.0, 3.0)
    assert Calibration.registered(camera).is_registered
    assert not Calibration(camera, camera.pinhole(), np.eye(4)).is_registered


@settings(max_examples=100, deadline=None)
@given(quaternions(), st.tuples(unit, unit, unit))
def test_quaternion_and_pose_turn_into_each_other(
    quaternion: np.ndarray, translation_m: tuple[float, float, float]
) -> None:
    pose = pose_from_quaternion(np.array(translation_m), quaternion)
    np.testing.assert_array_equal(require_rigid(pose, where="here"), pose)
    back = quaternion_from_pose(pose)
    assert back[3] >= 0
    assert np.linalg.norm(back) == pytest.approx(1.0, abs=1e-12)
    assert abs(back @ quaternion) == pytest.approx(1.0, abs=1e-12)
    again = pose_from_quaternion(pose[:3, 3], back)
    np.testing.assert_allclose(again, pose, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(quaternion_from_pose(pose), back)


@settings(max_examples=30, deadline=None)
@given(quaternions(), st.tuples(unit, unit, unit))
def test_transform_is_the_matrix_product(
    quaternion: np.ndarray, translation_m: tuple[float, float, float]
) -> None:
    pose = pose_from_quaternion(np.array(translation_m), quaternion)
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    homogeneous = np.concatenate([points, np.ones((4, 5, 1))], axis=-1)
    expected = np.einsum("ij,abj->abi", pose, homogeneous)[..., :3]
    np.testing.assert_allclose(transform(pose, points), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda pose: pose[:3], "has shape \\(3, 4\\)"),
        (lambda pose: pose * np.nan, "not finite"),
        (lambda pose: pose + np.diag([0, 0, 0, np.inf]), "not finite"),
        (lambda pose: pose @ np.diag([1.01, 1.01, 1.01, 1.0]), "not rigid"),
        (lambda pose: pose @ np.diag([-1.0, 1.0, 1.0, 1.0]), "not rigid.*mirrors"),
        (lambda pose: pose @ np.diag([0.0, 0.0, 0.0, 1.0]), "not rigid"),
        (np.transpose, "its last row"),
        (lambda pose: np.vstack([pose[:3], [0.0, 0.0, 0.1, 1.0]]), "not rigid"),
        (lambda pose: np.vstack([pose[:3], [0.0, 0.0, 0.0, 2.0]]), "not rigid"),
    ],
)
def test_what_is_not_rigid_is_refused(change: object, message: str) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
    pose[:3, 3] = 1.0, -2.0, 0.5
    with pytest.raises(ProgroundError, match=rf"^seq/pose\.txt: .*{message}.*; leave the frame"):
        require_rigid(change(pose), where="seq/pose.txt")  # type: ignore[operator]


def test_a_pose_of_six_digits_is_rigid_enough() -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix().round(6)
    np.testing.assert_array_equal(require_rigid(pose.tolist(), where="here"), pose)
