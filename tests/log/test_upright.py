from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from proground_log.camera import Camera
from proground_log.log.upright import levelled, nearest_axis, surface_normals, up_direction

CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
LEVEL = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""World from a camera that looks along y in a world with z up."""


def looking_round(roll_deg: float = 0.0, down_deg: float = 20.0) -> np.ndarray:
    """Poses of a camera that is turned about itself, pitched down and rolled by these angles."""
    poses = np.tile(np.eye(4), (12, 1, 1))
    held = Rotation.from_euler("x", -down_deg, degrees=True) * Rotation.from_euler(
        "z", roll_deg, degrees=True
    )
    for pose, turn in zip(poses, np.arange(0, 360, 30), strict=True):
        yaw = Rotation.from_euler("z", turn, degrees=True)
        pose[:3, :3] = yaw.as_matrix() @ LEVEL @ held.as_matrix()
    return poses


@pytest.mark.parametrize("roll_deg", [0.0, 90.0])
def test_up_is_found_for_cameras_and_for_phones_held_upright(roll_deg: float) -> None:
    up = up_direction(looking_round(roll_deg))
    assert np.degrees(np.arccos(up[2])) < 1
    assert nearest_axis(up) == (2, 1)


def test_normals_point_at_the_camera_and_stop_at_jumps() -> None:
    depth_m = np.full((48, 64), 2.0, np.float32)
    depth_m[:, 40:] = 3.0
    depth_m[:10] = 0.0
    normals = surface_normals(CAMERA.unproject(depth_m), reach=4)
    np.testing.assert_allclose(normals[20, 10], (0, 0, -1), atol=1e-6)
    np.testing.assert_allclose(normals[20, 50], (0, 0, -1), atol=1e-6)
    assert not normals[20, 37].any()
    assert not normals[:10].any()
    assert not normals[-4:].any()


def test_the_floor_corrects_the_guess() -> None:
    rng = np.random.default_rng(0)
    world = Rotation.from_euler("xyz", [30, 20, 10], degrees=True).as_matrix()
    floor, wall, other = world.T
    normals = np.repeat([floor, wall, other], [200, 500, 300], axis=0)
    normals = normals + rng.normal(0, 0.02, normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    guess = Rotation.from_rotvec(np.radians(25) * wall).apply(floor)
    assert levelled(guess, normals) @ floor > np.cos(np.radians(0.5))
    np.testing.assert_array_equal(levelled(guess, normals[:0]), guess)


def test_a_level_world_helps_a_camera_that_is_rolled() -> None:
    """Rolled by 50 degrees, a wall is nearer to the image's top than the floor is."""
    normals = np.repeat([[0.0, 0, 1], [1, 0, 0]], [300, 300], axis=0)
    rolled = np.array([np.sin(np.radians(50)), 0, np.cos(np.radians(50))])
    np.testing.assert_allclose(levelled(rolled, normals[:400]), (0, 0, 1), atol=1e-6)
