from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.redwood import RedwoodSource, recognise
from recorders.room.source import CAMERA
from tests.round_trip import assert_round_trip
from tests.writers.redwood import INTRINSIC, write_log, write_sequence


@pytest.mark.parametrize("colors", ["image", "color", "rgb"])
@pytest.mark.parametrize("timed", [False, True])
def test_the_room_comes_back(
    tmp_path: Path, room_frames: list[SensorFrame], colors: str, timed: bool
) -> None:
    frames = room_frames if colors == "color" else room_frames[:2]
    write_sequence(tmp_path / "a", frames, colors=colors, timed=timed)
    source = RedwoodSource(tmp_path / "a")
    reader = assert_round_trip(source, frames, tmp_path / "log.mcap")
    assert reader.calibration == Calibration.registered(CAMERA)
    frame = source.frame(1)
    assert frame.depth.dtype == np.uint16
    assert frame.stamp_ns == (33_333_000 if timed else 10**9 // 30)
    assert frame.color_stamp_ns - frame.stamp_ns == (4_000_000 if timed else 0)
    assert source.ground_truth_mesh() is None


def test_the_default_camera(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_sequence(tmp_path, room_frames[:1])
    (tmp_path / "camera_intrinsic.json").unlink()
    camera = Camera(640, 480, 525.0, 525.0, 320.0, 240.0)
    assert RedwoodSource(tmp_path).calibration == Calibration.registered(camera)


def test_frames_without_partner_or_pose_are_counted(
    tmp_path: Path, room_frames: list[SensorFrame]
) -> None:
    write_sequence(tmp_path / "a", room_frames, timed=True)
    poses = [frame.world_from_camera for frame in room_frames]
    write_log(tmp_path / "a/trajectory.log", poses[1:], first=1)
    sorted((tmp_path / "a/color").iterdir())[3].unlink()
    source = RedwoodSource(tmp_path / "a")
    assert source.notes == {"images without a partner": "1", "frames without a pose": "1"}
    kept = [room_frames[index] for index in (1, 2, 4, 5)]
    assert_round_trip(source, kept, tmp_path / "log.mcap")
    with pytest.raises(ProgroundError, match="no frame: 6 depth and 5 colour images make 0 pairs"):
        RedwoodSource(tmp_path / "a", max_time_difference_s=0.001)


def test_the_trajectory_may_be_elsewhere(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_sequence(tmp_path / "a", room_frames[:2])
    path = (tmp_path / "a/trajectory.log").rename(tmp_path / "a/lounge_trajectory.log")
    assert len(RedwoodSource(tmp_path / "a")) == 2
    path = path.rename(tmp_path / "a/first.log")
    write_log(tmp_path / "a/second.log", [np.eye(4)])
    with pytest.raises(ProgroundError, match=r"first\.log, second\.log\); pass .*`trajectory`"):
        RedwoodSource(tmp_path / "a")
    assert len(RedwoodSource(tmp_path / "a", trajectory=path)) == 2
    assert len(RedwoodSource(tmp_path / "a", trajectory=tmp_path / "a/second.log")) == 1
    with pytest.raises(ProgroundError, match=r"none\.log: no such file"):
        RedwoodSource(tmp_path / "a", trajectory=tmp_path / "none.log")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"a: no frame: 2 depth .* none of 0 poses"),
        ("one 1 2\n", r"trajectory\.log:1: does not begin a pose"),
        (f"{'9' * 5000} 1 2\n", r"trajectory\.log:1: does not begin a pose"),
        ("0 0 1\n1 0 0 0\n", r"trajectory\.log:1: is not a pose of 16 numbers"),
        ("\n0 0 1\n" + "nan nan nan nan\n" * 4, r"trajectory\.log:2: .* not finite"),
        ("2 2 3\n", "trajectory.log:1: image 2 is not one of 2 depth images"),
        ("-1 0 0\n", "trajectory.log:1: image -1 is not one of 2 depth images"),
    ],
)
def test_a_broken_trajectory_is_named(
    tmp_path: Path, room_frames: list[SensorFrame], text: str, message: str
) -> None:
    write_sequence(tmp_path / "a", room_frames[:2])
    (tmp_path / "a/trajectory.log").write_text(text)
    with pytest.raises(ProgroundError, match=message):
        RedwoodSource(tmp_path / "a")


def test_two_poses_of_one_image_are_refused(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_sequence(tmp_path, room_frames[:2])
    path = tmp_path / "trajectory.log"
    path.write_text(path.read_text() * 2)
    with pytest.raises(ProgroundError, match=r"trajectory\.log:11: image 0 has two poses"):
        RedwoodSource(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[]", "does not describe the camera"),
        ('{"width": 640}', "does not describe the camera"),
        (json.dumps({**INTRINSIC, "intrinsic_matrix": [1, 2]}), "does not describe the camera"),
        (json.dumps({**INTRINSIC, "width": float("inf")}), "does not describe the camera"),
        (json.dumps(INTRINSIC).replace("320", "1e999999999"), "does not describe the camera"),
        (json.dumps({**INTRINSIC, "intrinsic_matrix": [0.0] * 9}), "above 0"),
        (json.dumps({**INTRINSIC, "intrinsic_matrix": [float("nan")] * 9}), "above 0"),
        ("{", "is not JSON"),
    ],
)
def test_a_broken_camera_is_named(
    tmp_path: Path, room_frames: list[SensorFrame], content: str, message: str
) -> None:
    write_sequence(tmp_path, room_frames[:1])
    (tmp_path / "camera_intrinsic.json").write_text(content)
    with pytest.raises(ProgroundError, match=message) as caught:
        RedwoodSource(tmp_path)
    assert caught.value.where == str(tmp_path / "camera_intrinsic.json")


def test_missing_folders_and_broken_images_are_named(
    tmp_path: Path, room_frames: list[SensorFrame]
) -> None:
    with pytest.raises(ProgroundError, match="has none of the folders image, color, rgb"):
        RedwoodSource(tmp_path)
    (tmp_path / "a/rgb").mkdir(parents=True)
    with pytest.raises(ProgroundError, match="depth: no such folder"):
        RedwoodSource(tmp_path / "a")
    write_sequence(tmp_path / "b", room_frames[:2])
    path = tmp_path / "b/depth/00001.png"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ProgroundError, match=r"00001\.png: is not a whole PNG"):
        RedwoodSource(tmp_path / "b").frame(1)


def test_recognise(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_sequence(tmp_path / "a", room_frames[:1])
    assert recognise(tmp_path / "a") == "has trajectory.log, color/ and depth/"
    (tmp_path / "a/trajectory.log").rename(tmp_path / "a/groundtruth.txt")
    for path in (tmp_path / "a", tmp_path / "a/groundtruth.txt", tmp_path / "none", Path("\0")):
        assert recognise(path) is None


def test_open3ds_example(shared_data: Path, depth_agreement: Callable[..., float]) -> None:
    source = RedwoodSource(shared_data / "open3d_rgbd5" / "RGBD")
    assert len(source) == 5
    assert recognise(shared_data / "open3d_rgbd5" / "RGBD") is not None
    assert depth_agreement(source, source.frame(0), source.frame(4), 0.05) > 0.97
