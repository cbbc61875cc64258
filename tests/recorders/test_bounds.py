from __future__ import annotations

import numpy as np
import pytest

from proground_log.camera import Camera, pose_from_quaternion, transform
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.bounds import BoundsEstimator

CAMERA = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)


def frame_of(depth: np.ndarray, pose: np.ndarray | None = None) -> SensorFrame:
    return SensorFrame(0, 0, 0, b"", "png", depth, np.eye(4) if pose is None else pose)


def random_frames(count: int) -> list[SensorFrame]:
    rng = np.random.default_rng(5)
    frames = []
    for _ in range(count):
        depth = rng.gamma(4.0, 0.6, (CAMERA.height, CAMERA.width)).astype(np.float32)
        quaternion = rng.normal(size=4)
        pose = pose_from_quaternion(rng.normal(size=3), quaternion / np.linalg.norm(quaternion))
        frames.append(frame_of(depth, pose))
    return frames


def estimate(frames: list[SensorFrame]) -> tuple[np.ndarray, np.ndarray]:
    estimator = BoundsEstimator()
    for frame in frames:
        estimator.add(frame, CAMERA)
    bounds = estimator.bounds()
    return np.array(bounds.lower_m), np.array(bounds.upper_m)


def test_agrees_with_percentiles_of_every_eighth_pixel() -> None:
    frames = random_frames(12)
    points_m = np.concatenate(
        [
            transform(f.world_from_camera, CAMERA.unproject(f.depth_m)[4::8, 4::8]).reshape(-1, 3)
            for f in frames
        ]
    )
    lower_m, upper_m = estimate(frames)
    low, high = np.percentile(points_m, [0.1, 99.9], axis=0, method="inverted_cdf")
    # The margin is 0.3 m; rounding adds up to 0.1 m, a bin 0.01 m.
    np.testing.assert_allclose(low - lower_m, 0.35, atol=0.1)
    np.testing.assert_allclose(upper_m - high, 0.35, atol=0.1)


def test_a_wall_gives_the_numbers_by_hand() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 2.005, np.float32)
    lower_m, upper_m = estimate([frame_of(depth)])
    assert (lower_m[2], upper_m[2]) == (1.7, 2.4)


def test_metres_and_millimetres_agree() -> None:
    depth_mm = np.random.default_rng(2).integers(500, 4000, (120, 160), dtype=np.uint16)
    depth_m = depth_mm.astype(np.float32) * np.float32(1e-3)
    np.testing.assert_array_equal(estimate([frame_of(depth_mm)]), estimate([frame_of(depth_m)]))


def test_corners_are_whole_tenths_and_order_does_not_matter() -> None:
    frames = random_frames(6)
    corners = np.array(estimate(frames))
    assert [float(f"{x:.1f}") for x in corners.ravel()] == list(corners.ravel())
    np.testing.assert_array_equal(corners, estimate(frames[::-1]))


def test_invalid_depth_and_outliers_do_not_count() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    holed = depth.copy()
    holed[:40] = 0
    holed[40:60:3] = np.nan
    holed[41:60:3] = np.inf
    holed[42:60:3] = -1
    holed[4, 4] = 0
    expected = estimate([frame_of(depth[:60].repeat(2, axis=0))])[1][2]
    assert estimate([frame_of(holed)])[1][2] == expected
    far = depth.copy()
    far[4, 4] = 50.0  # a sampled pixel, one of 300 in each of 4 frames
    assert estimate([frame_of(far), *[frame_of(depth)] * 3])[1][2] == expected


def test_range_grows_both_ways() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 1.0, np.float32)
    frames = []
    for z in (0.0, -30.0, 30.0):
        pose = np.eye(4)
        pose[2, 3] = z
        frames.append(frame_of(depth, pose))
    lower_m, upper_m = estimate(frames)
    assert lower_m[2] == pytest.approx(-29.3)
    assert upper_m[2] == pytest.approx(31.4)


def test_no_depth_is_refused() -> None:
    estimator = BoundsEstimator()
    estimator.add(frame_of(np.zeros((120, 160), np.uint16)), CAMERA)
    with pytest.raises(ProgroundError, match="no frame has any valid depth"):
        estimator.bounds()


def test_a_point_out_of_this_world_is_refused() -> None:
    pose = np.eye(4)
    pose[0, 3] = 1e9
    with pytest.raises(ProgroundError, match="frame 0: all its points are over 10 km"):
        BoundsEstimator().add(frame_of(np.ones((120, 160), np.float32), pose), CAMERA)
