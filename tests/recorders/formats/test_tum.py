from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, quaternion_from_pose, transform
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.tum import TumSource, recognise
from recorders.room.source import CAMERA as ROOM_CAMERA
from tests.round_trip import assert_round_trip
from tests.writers.tum import CALIBRATION, COLOR_STAMPS, GROUND_TRUTH, write_sequence


def test_frames_come_back_exactly(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    depths = write_sequence(folder)
    source = TumSource(folder, calibration=CALIBRATION)
    assert (len(source), source.notes["pairs without a pose"]) == (3, "1")
    assert (source.label_names, source.ground_truth_mesh()) == ({}, None)
    for index in (1, 2, 0):
        frame = source.frame(index)
        assert frame.index == index
        assert frame.depth.dtype == np.float32
        np.testing.assert_array_equal(frame.depth, depths[index] / np.float32(5000))
        assert frame.color == (folder / f"rgb/{COLOR_STAMPS[index]}.png").read_bytes()
        assert frame.color_format == "png"
    assert source.frame(1).stamp_ns == 100_100_000_000
    assert source.frame(1).color_stamp_ns == 100_110_000_000


def test_poses_are_interpolated_at_the_depth_image(tmp_path: Path) -> None:
    write_sequence(tmp_path / "a")
    source = TumSource(tmp_path / "a", calibration=CALIBRATION)
    np.testing.assert_allclose(source.frame(0).world_from_camera[:3, 3], [2, 2, 3], atol=1e-12)
    turned = source.frame(1).world_from_camera
    half = np.sqrt(0.5)
    np.testing.assert_allclose(turned[:3, 0], [half, half, 0], atol=1e-3)
    np.testing.assert_allclose(turned[:3, 3], [3, 3, 3], atol=1e-12)


@pytest.mark.parametrize("name", ["../rgb/1.png", "/rgb/1.png", "9" * 5000])
def test_an_image_that_cannot_be_in_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    write_sequence(tmp_path / "a")
    (tmp_path / "a/rgb.txt").write_text(f"99.995 {name}\n")
    with pytest.raises(ProgroundError, match=r"rgb\.txt:1: .* is no file in this folder"):
        TumSource(tmp_path / "a", calibration=CALIBRATION)


def test_a_smaller_difference_pairs_fewer(tmp_path: Path) -> None:
    write_sequence(tmp_path / "a")
    source = TumSource(tmp_path / "a", calibration=CALIBRATION, max_time_difference_s=0.005)
    assert len(source) == 1
    with pytest.raises(ProgroundError, match="no frame: 4 depth and 4 colour images make 0 pairs"):
        TumSource(tmp_path / "a", calibration=CALIBRATION, max_time_difference_s=0.004)


@pytest.mark.parametrize(
    ("name", "fx", "distorted"),
    [
        ("rgbd_dataset_freiburg1_xyz", 517.3, True),
        ("fr2_desk", 520.9, True),
        ("Freiburg3_office", 535.4, False),
    ],
)
def test_the_name_tells_the_camera(tmp_path: Path, name: str, fx: float, distorted: bool) -> None:
    write_sequence(tmp_path / name)
    calibration = TumSource(tmp_path / name).calibration
    assert calibration.is_registered
    assert calibration.depth.fx == fx
    assert any(calibration.depth.distortion) == distorted


@pytest.mark.parametrize(
    ("name", "link"), [("desk", "fr2"), ("freiburg2_a", "desk"), ("freiburg1_a", "fr2")]
)
def test_a_link_has_a_name_too(tmp_path: Path, name: str, link: str) -> None:
    write_sequence(tmp_path / name)
    (tmp_path / link).symlink_to(name)
    assert TumSource(tmp_path / link).calibration.depth.fx == 520.9


@pytest.mark.parametrize("name", ["desk", "freiburg4_a", "fr12"])
def test_a_name_that_does_not_tell_is_refused(tmp_path: Path, name: str) -> None:
    write_sequence(tmp_path / name)
    with pytest.raises(ProgroundError, match=rf"{name}: .* pass the calibration"):
        TumSource(tmp_path / name)


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "groundtruth.txt"])
def test_a_missing_list_is_named(tmp_path: Path, name: str) -> None:
    write_sequence(tmp_path / "a")
    (tmp_path / "a" / name).unlink()
    with pytest.raises(ProgroundError, match=rf"{name}: no such file"):
        TumSource(tmp_path / "a", calibration=CALIBRATION)


@pytest.mark.parametrize("name", ["", "nowhere"])
def test_a_folder_without_lists_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(ProgroundError, match=rf"{tmp_path / name}/depth\.txt: no such file"):
        TumSource(tmp_path / name)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("100.02 1 2 3 0 0 0", r"groundtruth\.txt:7: has 7 columns, not 8"),
        ("100.02 1 2 x 0 0 0 1", r"groundtruth\.txt:7: has a column that is not a number"),
        ("soon 1 2 3 0 0 0 1", r"groundtruth\.txt:7: 'soon' is not a time"),
        ("100.02 nan 2 3 0 0 0 1", r"groundtruth\.txt: the pose has numbers that are not finite"),
        ("100.02 1 2 3 0 0 0 2", r"groundtruth\.txt: the pose's quaternion is not of norm 1"),
        ("100.05 4 2 3 0 0 0 1", r"groundtruth\.txt: another pose has the same time"),
    ],
)
def test_a_broken_pose_is_refused(tmp_path: Path, line: str, message: str) -> None:
    write_sequence(tmp_path / "a", ground_truth=GROUND_TRUTH + line + "\n")
    with pytest.raises(ProgroundError, match=message):
        TumSource(tmp_path / "a", calibration=CALIBRATION)


def test_a_pose_that_is_there_twice_does_no_harm(tmp_path: Path) -> None:
    write_sequence(tmp_path / "a", ground_truth=GROUND_TRUTH + "99.95 1 2 3 0 0 0 1\n")
    assert len(TumSource(tmp_path / "a", calibration=CALIBRATION)) == 3


def test_a_missing_image_is_named(tmp_path: Path) -> None:
    write_sequence(tmp_path / "a")
    (tmp_path / "a/depth/100.100000.png").unlink()
    source = TumSource(tmp_path / "a", calibration=CALIBRATION)
    with pytest.raises(ProgroundError, match=r"depth/100\.100000\.png: no such file"):
        source.frame(1)


T_ROS = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
T_M = np.array(
    [
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""As Bonn publishes them; T_m scales by the cube root of its determinant."""
BONN_SCALE = np.linalg.det(T_M) ** (1 / 3)


def write_bonn(folder: Path, frames: list[SensorFrame]) -> dict[int, np.ndarray]:
    """Write the room's frames as if Bonn's rig had seen them; returns T of groundtruth.txt."""
    rigid = T_M.copy()
    u, _, vt = np.linalg.svd(T_M[:3, :3])
    rigid[:3, :3] = u @ vt
    tracked = {
        index: np.linalg.inv(T_ROS) @ frame.world_from_camera @ np.linalg.inv(T_ROS @ rigid)
        for index, frame in enumerate(frames)
    }
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
        lines = [f"{10 + index} {name}/{index}.png" for index in tracked]
        (folder / f"{name}.txt").write_text("\n".join(lines))
    rows = []
    for index, (frame, pose) in enumerate(zip(frames, tracked.values(), strict=True)):
        (folder / f"rgb/{index}.png").write_bytes(frame.color)
        units = np.round(frame.depth_m / BONN_SCALE * 5000).astype(np.uint16)
        cv2.imwrite(str(folder / f"depth/{index}.png"), units)
        numbers = [10 + index, *pose[:3, 3], *quaternion_from_pose(pose)]
        rows.append(" ".join(repr(float(number)) for number in numbers))
    (folder / "groundtruth.txt").write_text("\n".join(rows))
    return tracked


def test_bonn_by_the_published_formula(
    tmp_path: Path, room_frames: list[SensorFrame], depth_agreement: Callable[..., float]
) -> None:
    folder = tmp_path / "rgbd_bonn_room"
    tracked = write_bonn(folder, room_frames)
    source = TumSource(folder, calibration=Calibration.registered(ROOM_CAMERA))
    assert "depth x 1.0593" in source.notes["Bonn's T_m"]
    assert_round_trip(source, room_frames, tmp_path / "log.mcap", depth_atol_m=2e-4)
    assert depth_agreement(source, source.frame(0), source.frame(4), 0.05) > 0.95
    units = cv2.imread(str(folder / "depth/3.png"), cv2.IMREAD_UNCHANGED)
    theirs = ROOM_CAMERA.unproject(units / 5000.0).reshape(-1, 3)
    theirs = transform(np.linalg.inv(T_ROS) @ tracked[3] @ T_ROS @ T_M, theirs)
    frame = source.frame(3)
    ours = ROOM_CAMERA.unproject(frame.depth).reshape(-1, 3)
    np.testing.assert_allclose(transform(frame.world_from_camera, ours), theirs, atol=1e-3)


def test_bonns_camera(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    folder = tmp_path / "rgbd_bonn_balloon2"
    write_bonn(folder, room_frames[:1])
    calibration = TumSource(folder).calibration
    assert calibration.is_registered
    assert (calibration.depth.fx, calibration.depth.cy) == (542.822841, 238.256098)
    assert calibration.depth.distortion == (0.039903, -0.099343, -0.00073, -0.000144, 0.0)


def test_recognise(tmp_path: Path) -> None:
    write_sequence(tmp_path / "a")
    assert recognise(tmp_path / "a") == "has rgb.txt, depth.txt and groundtruth.txt"
    (tmp_path / "a/groundtruth.txt").unlink()
    for path in (tmp_path / "a", tmp_path / "a/rgb.txt", tmp_path / "none", Path("\0")):
        assert recognise(path) is None


def test_freiburg1(shared_data: Path, depth_agreement: Callable[..., float]) -> None:
    source = TumSource(shared_data / "tum_fr1_rpy_sample" / "rgbd_dataset_freiburg1_rpy")
    frames = [source.frame(index) for index in range(len(source))]
    assert len(frames) + int(source.notes["pairs without a pose"]) == 12
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(frames))
    assert frames[0].stamp_ns == 1_305_031_229_528_784_000
    assert depth_agreement(source, frames[0], frames[1], 0.05) > 0.93
