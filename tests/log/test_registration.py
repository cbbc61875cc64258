"""Registration against a slow one in plain numpy, and against OpenCV."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from proground_log.camera import Calibration, Camera, transform
from proground_log.errors import ProgroundError
from proground_log.frame import Frame, SensorFrame
from proground_log.log.reader import LogReader
from proground_log.log.registration import OCCLUSION_TOLERANCE_M, Registration
from tests.writers.small_source import CAMERA, SmallSource

COLOR = Camera(48, 40, 40.0, 41.0, 24.5, 19.0)
LENS = (0.12, -0.2, 0.003, -0.002, 0.05)
FISHEYE = (0.1, -0.02, 0.01, -0.004)


def rig(*, color: Camera = COLOR, baseline_m: float = 0.1) -> Calibration:
    depth_from_color = np.eye(4)
    depth_from_color[:3, :3] = Rotation.from_rotvec([0.02, -0.03, 0.05]).as_matrix()
    depth_from_color[:3, 3] = baseline_m, 0.01, -0.02
    return Calibration(color, CAMERA, depth_from_color)


def smooth_depth(index: int) -> np.ndarray:
    """Millimetres, in waves with holes."""
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    depth = 1500 + 300 * np.sin(columns / 5 + index) + 200 * np.cos(rows / 4)
    depth[np.random.default_rng(index).random(depth.shape) < 0.1] = 0
    return depth.astype(np.uint16)


def sensor_frame(calibration: Calibration, depth: np.ndarray) -> SensorFrame:
    source = SmallSource(calibration=calibration, with_labels=True)
    return replace(source.frame(2), depth=depth)


def reference(
    calibration: Calibration, sensor: SensorFrame
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Colour [H, W, 3] float, labels, validity, and where rounding could decide otherwise."""
    camera, color = calibration.color, sensor.decode_color().astype(np.float64)
    color_from_depth = np.linalg.inv(calibration.depth_from_color)
    depth_m = sensor.depth_m.astype(np.float64)
    seen: dict[tuple[int, int], float] = {}
    places = np.full((*depth_m.shape, 3), np.nan)
    unsure = np.zeros(depth_m.shape, bool)
    for row, column in np.ndindex(*depth_m.shape):
        z = depth_m[row, column]
        if z == 0:
            continue
        x = (column + 0.5 - calibration.depth.cx) / calibration.depth.fx * z
        y = (row + 0.5 - calibration.depth.cy) / calibration.depth.fy * z
        px, py, pz = transform(color_from_depth, np.array([x, y, z]))
        u, v = camera.fx * px / pz + camera.cx - 0.5, camera.fy * py / pz + camera.cy - 0.5
        edges = [u, v, u - (camera.width - 1), v - (camera.height - 1)]
        unsure[row, column] = min(map(abs, edges)) < 1e-3 or any(
            abs(value % 1 - 0.5) < 1e-2 for value in (u, v)
        )
        if 0 <= u <= camera.width - 1 and 0 <= v <= camera.height - 1:
            places[row, column] = u, v, pz
            pixel = round(v), round(u)
            seen[pixel] = min(seen.get(pixel, np.inf), pz)
    out = np.zeros((*depth_m.shape, 3))
    labels = np.zeros(depth_m.shape, np.uint16)
    valid = np.zeros(depth_m.shape, bool)
    assert sensor.labels is not None
    for row, column in np.ndindex(*depth_m.shape):
        u, v, pz = places[row, column]
        if np.isnan(u) or pz > seen[round(v), round(u)] + OCCLUSION_TOLERANCE_M:
            continue
        j, i = min(int(u), camera.width - 2), min(int(v), camera.height - 2)
        a, b = u - j, v - i
        out[row, column] = (
            (1 - a) * (1 - b) * color[i, j]
            + a * (1 - b) * color[i, j + 1]
            + (1 - a) * b * color[i + 1, j]
            + a * b * color[i + 1, j + 1]
        )
        labels[row, column] = sensor.labels[round(v), round(u)]
        valid[row, column] = True
    return out, labels, valid, unsure


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("baseline_m", [0.0, 0.1, -0.4])
def test_colour_and_labels_are_looked_up_through_depth(index: int, baseline_m: float) -> None:
    calibration = rig(baseline_m=baseline_m)
    sensor = sensor_frame(calibration, smooth_depth(index))
    frame = Registration(calibration)(sensor)
    color, labels, valid, unsure = reference(calibration, sensor)
    assert unsure.mean() < 0.1
    assert 0.2 < valid.mean() < 0.95
    sure = ~unsure
    np.testing.assert_array_equal(frame.color_valid[sure], valid[sure])
    # OpenCV interpolates with weights of 1/32.
    assert np.abs(frame.color[sure] - color[sure]).max() <= 6
    assert np.abs(frame.color[sure] - color[sure]).mean() < 0.6
    assert frame.labels is not None
    np.testing.assert_array_equal(frame.labels[sure], labels[sure])
    np.testing.assert_array_equal(frame.depth_m, sensor.depth_m)
    assert frame.camera == CAMERA
    assert not frame.color[~frame.color_valid].any()


def test_what_is_hidden_from_the_colour_camera_has_no_colour() -> None:
    """A pole in front of a wall, seen by a colour camera 20 cm to the side."""
    camera = Camera(64, 32, 50.0, 50.0, 32.0, 16.0)
    depth_from_color = np.eye(4)
    depth_from_color[0, 3] = 0.2
    calibration = Calibration(camera, camera, depth_from_color)
    depth = np.full((32, 64), 2000, np.uint16)
    depth[:, 30:34] = 1000
    frame = Registration(calibration)(sensor_frame(calibration, depth))
    # The pole covers 10 pixels in the colour image, the wall behind it 5 to its left.
    row = frame.color_valid[16]
    assert row[30:34].all()
    hidden = np.flatnonzero(~row[8:60]) + 8
    assert list(hidden) == [25, 26, 27, 28]


def test_a_registered_source_passes_through() -> None:
    source = SmallSource(with_labels=True, in_metres=True)
    register = Registration(source.calibration)
    for index in range(3):
        sensor = source.frame(index)
        frame = register(sensor)
        np.testing.assert_array_equal(frame.color, sensor.decode_color())
        np.testing.assert_array_equal(frame.depth_m, sensor.depth)
        np.testing.assert_array_equal(frame.labels, sensor.labels)
        assert frame.color_valid.all()
        assert (frame.index, frame.stamp_ns) == (sensor.index, sensor.stamp_ns)
        np.testing.assert_array_equal(frame.world_from_camera, sensor.world_from_camera)


def test_millimetres_become_metres() -> None:
    sensor = SmallSource().frame(0)
    depth_m = Registration(SmallSource().calibration)(sensor).depth_m
    assert depth_m.dtype == np.float32
    np.testing.assert_allclose(depth_m, sensor.depth / 1000.0, rtol=2e-7)


@pytest.mark.parametrize("lens", [LENS, (*LENS, 0.02, -0.01, 0.005), FISHEYE])
def test_distortion_is_taken_out_as_opencv_does_it(lens: tuple[float, ...]) -> None:
    camera = replace(CAMERA, distortion=lens)
    calibration = Calibration.registered(camera)
    sensor = sensor_frame(calibration, smooth_depth(0))
    frame = Registration(calibration)(sensor)
    assert frame.camera == CAMERA
    k, d = camera.k_integer_centres, np.array(lens)
    if lens == FISHEYE:
        expected = cv2.fisheye.undistortImage(sensor.decode_color(), k, d, Knew=k)
    else:
        expected = cv2.undistort(sensor.decode_color(), k, d)
    assert np.abs(frame.color.astype(int) - expected).max() <= 4
    # Depth and labels are taken from one pixel, never mixed: the one that the lens shows there.
    pixels = camera.project(CAMERA.directions.reshape(-1, 3).astype(np.float64))
    u, v = (pixels - 0.5).reshape(24, 32, 2).transpose(2, 0, 1)
    inside = (u > -0.5) & (u < 31.5) & (v > -0.5) & (v < 23.5)
    sure = (np.abs(u % 1 - 0.5) > 0.02) & (np.abs(v % 1 - 0.5) > 0.02)
    columns, rows = np.clip(u.round(), 0, 31).astype(int), np.clip(v.round(), 0, 23).astype(int)
    for found, source in ((frame.depth_m, sensor.depth_m), (frame.labels, sensor.labels)):
        assert found is not None
        assert source is not None
        nearest = np.where(inside, source[rows, columns], 0)
        np.testing.assert_array_equal(found[sure], nearest[sure])
    np.testing.assert_array_equal(frame.color_valid[sure], inside[sure])


def test_a_frame_with_cameras_of_its_own_is_registered_with_them() -> None:
    recording = rig()
    own = rig(color=replace(COLOR, fx=44.0, distortion=LENS))
    register = Registration(recording)
    sensor = sensor_frame(own, smooth_depth(1))
    expected = Registration(own)(sensor)
    found = register(replace(sensor, calibration=own))
    np.testing.assert_array_equal(found.color, expected.color)
    assert not np.array_equal(register(sensor).color, expected.color)


def test_a_distorted_colour_camera_is_undistorted_before_the_lookup() -> None:
    calibration = rig(color=replace(COLOR, distortion=LENS))
    sensor = sensor_frame(calibration, smooth_depth(1))
    frame = Registration(calibration)(sensor)
    camera = calibration.color
    points = CAMERA.unproject(sensor.depth_m).reshape(-1, 3).astype(np.float64)
    points = transform(np.linalg.inv(calibration.depth_from_color), points)
    u, v = (camera.project(points) - 0.5).T.astype(np.float32).reshape(2, 24, 32)
    direct = cv2.remap(sensor.decode_color(), u, v, cv2.INTER_LINEAR).astype(int)
    valid = frame.color_valid
    assert valid.mean() > 0.3
    # Interpolated once here and twice there, in an image with 4 by 5 colours.
    assert np.abs(frame.color[valid] - direct[valid]).mean() < 3


@pytest.mark.parametrize(
    ("size", "what"), [((24, 31), "31x24"), ((25, 32), "32x25"), ((240, 320), "320x240")]
)
def test_an_image_of_another_size_is_refused(size: tuple[int, int], what: str) -> None:
    for calibration in (Calibration.registered(CAMERA), rig(color=CAMERA)):
        sensor = sensor_frame(calibration, np.ones(size, np.uint16))
        message = f"frame 2, /camera/depth/image: the image is {what}, the camera 32x24; "
        with pytest.raises(ProgroundError, match=message):
            Registration(calibration)(sensor)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
@pytest.mark.parametrize("color_format", ["png", "jpeg"])
def test_a_truncated_colour_image_is_refused(share: float, color_format: str) -> None:
    sensor = SmallSource(color_format=color_format).frame(2)
    cut = replace(sensor, color=sensor.color[: int(share * len(sensor.color))])
    with pytest.raises(
        ProgroundError, match=f"^frame 2: the {color_format} image is cut short or damaged; "
    ):
        cut.decode_color()


def test_a_colour_image_that_is_none_is_refused() -> None:
    sensor = SmallSource().frame(2)
    broken = replace(sensor, color=b"nothing" + sensor.color[-12:])
    with pytest.raises(ProgroundError, match=r"^frame 2: the png image is cut short or damaged; "):
        broken.decode_color()


def test_the_room_is_registered(room_log: Path) -> None:
    reader = LogReader(room_log)
    register = Registration(reader.calibration)
    frames: list[Frame] = [register(sensor) for sensor in reader.frames([0, 11])]
    assert [frame.index for frame in frames] == [0, 11]
    assert all(frame.color_valid.all() for frame in frames)
