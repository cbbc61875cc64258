from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.nerfstudio import NerfstudioSource, recognise
from recorders.room.render import look
from recorders.room.source import CAMERA, RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.nerfstudio import INTRINSICS, write, write_data_set


@pytest.fixture
def content(tmp_path: Path, room_frames: list[SensorFrame]) -> dict[str, Any]:
    return write_data_set(tmp_path, room_frames[:3])


def test_the_room_comes_back(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_data_set(tmp_path, room_frames)
    source = NerfstudioSource(tmp_path)
    # Millimetres stay whole numbers, and frame_8 comes before frame_10.
    reader = assert_round_trip(source, room_frames, tmp_path / "log.mcap")
    assert reader.calibration == Calibration.registered(CAMERA)
    assert source.frame(1).stamp_ns == 10**9 // 30
    assert source.frame(0).depth.dtype == np.uint16
    assert source.ground_truth_mesh() is None
    assert source.notes["frames without depth"] == "0"
    assert len(NerfstudioSource(tmp_path / "transforms.json")) == 6


def test_frames_without_depth_or_pose_are_counted(
    tmp_path: Path, content: dict[str, Any], room_frames: list[SensorFrame]
) -> None:
    del content["frames"][2]["depth_file_path"]
    content["frames"][0]["transform_matrix"][1][3] = float("inf")
    write(tmp_path, content)
    source = NerfstudioSource(tmp_path)
    assert (source.notes["frames without depth"], source.notes["frames without a pose"]) == (
        "1",
        "1",
    )
    assert len(source) == 1
    # The time is that of its place among all.
    assert source.frame(0).stamp_ns == 10**9 // 30
    assert source.frame(0).color == room_frames[1].color
    for frame in content["frames"]:
        frame.pop("depth_file_path", None)
    write(tmp_path, content)
    with pytest.raises(ProgroundError, match=r"transforms\.json: none of 3 frames .*`colmap`"):
        NerfstudioSource(tmp_path)


def test_positions_are_in_metres(
    tmp_path: Path, content: dict[str, Any], room_frames: list[SensorFrame]
) -> None:
    for frame in content["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] *= 0.25
        frame["transform_matrix"] = matrix.tolist()
    transform = np.eye(4)[:3].tolist()
    write(tmp_path, {**content, "applied_scale": 0.25, "applied_transform": transform})
    source = NerfstudioSource(tmp_path)
    assert_round_trip(source, room_frames[:3], tmp_path / "log.mcap")
    assert source.notes["applied_scale"] == "undone: positions are divided by 0.25"
    assert "applied_transform" in source.notes["world axes"]


@pytest.mark.parametrize("in_file", [True, False])
def test_depth_in_another_unit(
    tmp_path: Path, content: dict[str, Any], room_frames: list[SensorFrame], in_file: bool
) -> None:
    for index, frame in enumerate(reversed(content["frames"])):
        depth = (room_frames[index].depth // 2).astype(np.uint16)
        cv2.imwrite(str(tmp_path / frame["depth_file_path"]), depth)
    if in_file:
        write(tmp_path, {**content, "depth_unit_scale_factor": 0.002})
        source = NerfstudioSource(tmp_path)
    else:
        source = NerfstudioSource(tmp_path, depth_unit_scale_factor=0.002)
    assert source.frame(0).depth.dtype == np.float32
    assert_round_trip(source, room_frames[:3], tmp_path / "log.mcap", depth_atol_m=0.0011)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16, np.uint16])
def test_depth_as_npy(
    tmp_path: Path, content: dict[str, Any], room_frames: list[SensorFrame], kind: type
) -> None:
    for index, frame in enumerate(reversed(content["frames"])):
        depth = room_frames[index].depth_m / 0.5
        order = np.asfortranarray if index == 1 else np.ascontiguousarray
        frame["depth_file_path"] = f"depths/{index}.npy"
        image = order(depth.astype(kind))
        np.save(tmp_path / "depths" / str(index), image[..., None] if index == 2 else image)
    write(tmp_path, content)
    source = NerfstudioSource(tmp_path, depth_unit_scale_factor=0.5)
    atol_m = {np.float16: 0.01, np.uint16: 0.51}.get(kind, 1e-6)
    assert_round_trip(source, room_frames[:3], tmp_path / "log.mcap", depth_atol_m=atol_m)


def test_what_no_depth_can_be_is_nothing(tmp_path: Path, content: dict[str, Any]) -> None:
    frame = content["frames"][2]
    depth = np.full((240, 320), 2.0)
    depth[0, :4] = np.nan, np.inf, -1.0, 1e300
    np.save(tmp_path / "depths/odd.npy", depth)
    frame["depth_file_path"] = "depths/odd.npy"
    write(tmp_path, content)
    depth_m = NerfstudioSource(tmp_path, depth_unit_scale_factor=1.0).frame(0).depth
    assert depth_m[0, :5].tolist() == [0.0, 0.0, 0.0, 0.0, 2.0]


def test_depth_of_another_size(
    tmp_path: Path,
    room: RoomSource,
    room_frames: list[SensorFrame],
    content: dict[str, Any],
    depth_agreement: Callable[..., float],
) -> None:
    small = Camera(160, 90, 100.0, 75.0, 80.0, 45.0)
    for index, frame in enumerate(reversed(content["frames"])):
        view = look(room._geometry, small, room_frames[index].world_from_camera)
        depth_mm = np.round(view.depth_m * 1000).astype(np.uint16)
        cv2.imwrite(str(tmp_path / frame["depth_file_path"]), depth_mm)
    source = NerfstudioSource(tmp_path)
    assert source.calibration == Calibration(CAMERA, small, np.eye(4))
    assert depth_agreement(source, source.frame(0), source.frame(2), 0.05) > 0.95


def test_each_frame_may_have_its_camera(tmp_path: Path, content: dict[str, Any]) -> None:
    for key in INTRINSICS:
        del content[key]
    for index, frame in enumerate(reversed(content["frames"])):
        frame.update(INTRINSICS, fl_x=200.0 + index)
    write(tmp_path, content)
    source = NerfstudioSource(tmp_path)
    assert source.calibration.color.fx == 200.0
    assert source.frame(0).calibration is None
    later = source.frame(2).calibration
    assert later == Calibration.registered(Camera(320, 240, 202.0, 200.0, 160.0, 120.0))
    given = Calibration.registered(CAMERA)
    assert NerfstudioSource(tmp_path, calibration=given).frame(2).calibration is None


@pytest.mark.parametrize(
    ("entries", "camera"),
    [
        ({"k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4}, (0.1, 0.2, 0.3, 0.4, 0.0)),
        ({"k1": 0.0, "camera_model": "PINHOLE"}, ()),
        ({"k1": 0.1, "k3": 0.5, "k4": 0.2, "camera_model": "OPENCV_FISHEYE"}, (0.1, 0, 0.5, 0.2)),
    ],
)
def test_lenses(
    tmp_path: Path, content: dict[str, Any], entries: dict[str, Any], camera: tuple[float, ...]
) -> None:
    write(tmp_path, {**content, **entries})
    source = NerfstudioSource(tmp_path)
    assert source.calibration.color.distortion == camera
    assert source.calibration.is_registered


def test_a_blender_file(tmp_path: Path, content: dict[str, Any]) -> None:
    for key in (*INTRINSICS, "camera_model"):
        del content[key]
    content["camera_angle_x"] = 2 * math.atan(160 / 200)
    for frame in content["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".jpg")
    (tmp_path / "transforms_train.json").write_text(json.dumps(content))
    camera = NerfstudioSource(tmp_path / "transforms_train.json").calibration.color
    assert camera.fx == camera.fy == pytest.approx(200.0)
    assert (camera.width, camera.height, camera.cx, camera.cy) == (320, 240, 160.0, 120.0)


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "[]", '{"frames": 1}', "9" * 5000])
def test_a_file_that_is_no_data_set(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(ProgroundError, match=r"transforms\.json: (is not JSON|has no list)"):
        NerfstudioSource(tmp_path)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"fl_x": None}, "does not describe the camera"),
        ({"fl_x": "wide"}, "does not describe the camera"),
        ({"w": float("inf")}, "does not describe the camera"),
        ({"fl_x": -1}, "above 0"),
        ({"cy": float("nan")}, "finite"),
        ({"h": 10**9}, "sizes"),
        ({"camera_model": "EQUIRECTANGULAR"}, "'EQUIRECTANGULAR' has no pinhole"),
        ({"camera_model": ["OPENCV"]}, "has no pinhole"),
        ({"k4": 0.1}, "has k4"),
        ({"applied_scale": 0}, "applied_scale is 0"),
        ({"depth_unit_scale_factor": "mm"}, "depth_unit_scale_factor is mm"),
        ({"frames": []}, "none of 0 frames"),
        ({"frames": [{}]}, "frame 0: has no file_path"),
        ({"frames": [7]}, "frame 0: has no file_path"),
    ],
)
def test_a_broken_entry_is_named(
    tmp_path: Path, content: dict[str, Any], entries: dict[str, Any], message: str
) -> None:
    write(tmp_path, {**content, **entries})
    with pytest.raises(ProgroundError, match=message) as caught:
        NerfstudioSource(tmp_path)
    assert str(tmp_path / "transforms.json") in str(caught.value)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"file_path": "/etc/passwd"}, "leads out of the data set"),
        ({"file_path": "images/../../secret.png"}, "leads out of the data set"),
        ({"depth_file_path": "s3://bucket/depth.png"}, "leads out of the data set"),
        ({"depth_file_path": 7}, "leads out of the data set"),
        ({"file_path": ""}, "leads out of the data set"),
        ({"file_path": "images/none.jpg"}, "there is no file 'images/none.jpg'"),
        ({"depth_file_path": f"{'a' * 5000}/1.png"}, "there is no file"),
        ({"depth_file_path": "depths\0/1.png"}, "there is no file"),
        ({"transform_matrix": [[1, 2], [3]]}, "not a matrix of numbers"),
        ({"transform_matrix": [[1, 2], [3, 4]]}, "has shape"),
        ({"transform_matrix": (2 * np.eye(4)).tolist()}, "not rigid"),
    ],
)
def test_a_broken_frame_is_named(
    tmp_path: Path, content: dict[str, Any], entries: dict[str, Any], message: str
) -> None:
    content["frames"][1].update(entries)
    write(tmp_path, content)
    with pytest.raises(ProgroundError, match=rf"transforms\.json, frame 1: .*{message}"):
        NerfstudioSource(tmp_path)


def test_images_of_another_size_are_named(tmp_path: Path, content: dict[str, Any]) -> None:
    cv2.imwrite(str(tmp_path / "images/frame_9.jpg"), np.zeros((9, 9, 3), np.uint8))
    np.save(tmp_path / "depths/frame_10.npy", np.ones((5, 5)))
    content["frames"][0]["depth_file_path"] = "depths/frame_10.npy"
    write(tmp_path, content)
    source = NerfstudioSource(tmp_path)
    with pytest.raises(ProgroundError, match=r"frame_9\.jpg: is 9x9"):
        source.frame(1)
    with pytest.raises(ProgroundError, match=r"frame_10\.npy: is 5x5, but the others are 320x240"):
        source.frame(2)


def test_recognise(tmp_path: Path, content: dict[str, Any]) -> None:
    assert recognise(tmp_path) == "has transforms.json"
    assert recognise(tmp_path / "transforms.json") == "is a transforms.json"
    assert recognise(tmp_path / "images/frame_8.jpg") is None
    assert recognise(tmp_path / "images") is None
    assert recognise(tmp_path / "none/transforms.json") is None
    assert recognise(Path("\0")) is None
    assert content
