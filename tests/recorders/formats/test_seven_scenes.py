from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera, pose_from_quaternion, transform
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.log.registration import Registration
from recorders.formats.seven_scenes import SevenScenesSource, recognise

CAMERA = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)
CALIBRATION = Calibration.registered(CAMERA)
NUMBERS = (3, 20, 100)


def write_sequence(
    folder: Path, *, color_suffix: str = ".jpg"
) -> dict[int, tuple[np.ndarray, ...]]:
    """Write a small sequence; returns depth, colour and pose by frame number."""
    rng = np.random.default_rng(3)
    folder.mkdir(parents=True)
    written = {}
    for number in NUMBERS:
        depth = rng.integers(0, 65535, (24, 32), dtype=np.uint16)
        color = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
        quaternion = rng.normal(size=4)
        pose = pose_from_quaternion(rng.normal(size=3), quaternion / np.linalg.norm(quaternion))
        stem = folder / f"frame-{number:06d}"
        cv2.imwrite(f"{stem}.color{color_suffix}", color)
        written_depth = depth.copy()
        written_depth[0, :5] = 65535
        depth[0, :5] = 0
        cv2.imwrite(f"{stem}.depth.png", written_depth)
        np.savetxt(f"{stem}.pose.txt", pose)
        written[number] = (depth, color, pose)
    return written


@pytest.mark.parametrize("color_suffix", [".jpg", ".png"])
def test_frames_come_back_exactly_in_any_order(tmp_path: Path, color_suffix: str) -> None:
    folder = tmp_path / "seq-07"
    written = write_sequence(folder, color_suffix=color_suffix)
    source = SevenScenesSource(folder, calibration=CALIBRATION)
    assert len(source) == 3
    for index in (2, 0, 1):
        frame, number = source.frame(index), NUMBERS[index]
        depth, color, pose = written[number]
        np.testing.assert_array_equal(frame.depth, depth)
        assert frame.depth.dtype == np.uint16
        np.testing.assert_array_equal(frame.world_from_camera, pose)
        color_path = folder / f"frame-{number:06d}.color{color_suffix}"
        assert frame.color == color_path.read_bytes()
        if color_suffix == ".png":
            np.testing.assert_array_equal(frame.decode_color(), color[..., ::-1])
        assert (frame.index, frame.stamp_ns) == (index, number * 10**9 // 30)
        assert frame.color_stamp_ns == frame.stamp_ns
        assert frame.labels is None
    assert source.ground_truth_mesh() is None
    assert source.label_names == {}


def test_a_scene_with_one_sequence_will_do(tmp_path: Path) -> None:
    write_sequence(tmp_path / "seq-01")
    assert len(SevenScenesSource(tmp_path, calibration=CALIBRATION)) == 3


def test_several_sequences_are_listed(tmp_path: Path) -> None:
    write_sequence(tmp_path / "seq-01")
    write_sequence(tmp_path / "seq-02")
    with pytest.raises(ProgroundError, match="seq-01, seq-02"):
        SevenScenesSource(tmp_path)


def test_empty_and_missing_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        ProgroundError, match=rf"{tmp_path}: has no images such as frame-000000\.depth\.png"
    ):
        SevenScenesSource(tmp_path)
    with pytest.raises(ProgroundError, match="gone: no such folder"):
        SevenScenesSource(tmp_path / "gone")


@pytest.mark.parametrize("part", ["color.jpg", "pose.txt"])
def test_a_missing_file_is_named(tmp_path: Path, part: str) -> None:
    folder = tmp_path / "seq-01"
    write_sequence(folder)
    (folder / f"frame-000020.{part}").unlink()
    with pytest.raises(ProgroundError, match=rf"frame-000020\.{part[:4]}"):
        SevenScenesSource(folder)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def shrink(path: Path) -> None:
    cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2, ::2])


def narrow(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((24, 32), np.uint8))


@pytest.mark.parametrize(
    ("part", "spoil", "message"),
    [
        ("color.jpg", cut, "cut short"),
        ("color.jpg", shrink, "16x12"),
        ("depth.png", cut, "not a whole PNG"),
        ("depth.png", shrink, "16x12"),
        ("depth.png", narrow, "8 bits"),
    ],
)
def test_a_spoilt_file_is_named(
    tmp_path: Path, part: str, spoil: Callable[[Path], None], message: str
) -> None:
    folder = tmp_path / "seq-01"
    write_sequence(folder)
    spoil(folder / f"frame-000020.{part}")
    source = SevenScenesSource(folder, calibration=CALIBRATION)
    source.frame(0)
    with pytest.raises(ProgroundError, match=message) as caught:
        source.frame(1)
    assert str(folder / f"frame-000020.{part}") in str(caught.value)


@pytest.mark.parametrize("lost", [np.full((4, 4), -np.inf), np.zeros((4, 4))])
def test_frames_that_were_not_tracked_are_left_out_and_counted(
    tmp_path: Path, lost: np.ndarray
) -> None:
    folder = tmp_path / "seq-01"
    written = write_sequence(folder)
    np.savetxt(folder / "frame-000020.pose.txt", lost)
    source = SevenScenesSource(folder, calibration=CALIBRATION)
    assert (len(source), source.notes["frames without a pose"]) == (2, "1")
    np.testing.assert_array_equal(source.frame(1).world_from_camera, written[100][2])
    assert source.frame(1).stamp_ns == 100 * 10**9 // 30
    for number in (3, 100):
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", lost)
    with pytest.raises(ProgroundError, match="seq-01: none of the 3 frames has a pose"):
        SevenScenesSource(folder)


def test_a_pose_that_is_not_rigid_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "seq-01"
    write_sequence(folder)
    np.savetxt(folder / "frame-000020.pose.txt", np.diag([1.1, 1.1, 1.1, 1.0]))
    with pytest.raises(ProgroundError, match=r"frame-000020\.pose\.txt: .*not rigid"):
        SevenScenesSource(folder)


def test_recognise(tmp_path: Path) -> None:
    write_sequence(tmp_path / "scene/seq-01")
    for path in (tmp_path / "scene/seq-01", tmp_path / "scene"):
        assert recognise(path) == "has frame-*.depth.png, frame-*.color.* and frame-*.pose.txt"
    for path in (tmp_path, next((tmp_path / "scene/seq-01").iterdir()), Path("\0")):
        assert recognise(path) is None


def test_the_kitchen(shared_data: Path, depth_agreement: Callable[..., float]) -> None:
    source = SevenScenesSource(shared_data / "7scenes_redkitchen")
    assert len(source) == 250
    first, later = source.frame(0), source.frame(10)  # files 0 and 40: 10 cm and 4 degrees apart
    assert later.stamp_ns == 40 * 10**9 // 30
    assert first.color_format == "jpeg"
    assert depth_agreement(source, first, later, 0.05) > 0.965


def color_error(calibration: Calibration, first: SensorFrame, second: SensorFrame) -> float:
    """Mean difference of the colours that two frames give to the same places, up to 60."""
    register = Registration(calibration)
    a, b = register(first), register(second)
    camera, seen = a.camera, (a.depth_m > 0) & a.color_valid
    b_from_a = np.linalg.inv(b.world_from_camera) @ a.world_from_camera
    points_m = transform(b_from_a, camera.unproject(a.depth_m)[seen].astype(np.float64))
    columns, rows = np.floor(camera.project(points_m)).astype(int).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    rows, columns = rows[inside], columns[inside]
    same = np.abs(b.depth_m[rows, columns] - points_m[inside, 2]) < 0.02
    same &= b.color_valid[rows, columns]
    difference = a.color[seen][inside].astype(float) - b.color[rows, columns]
    difference = difference[same] - np.median(difference[same], axis=0)
    return float(np.minimum(np.abs(difference), 60).mean())


def test_the_kitchens_color_camera_beats_what_was_known(shared_data: Path) -> None:
    source = SevenScenesSource(shared_data / "7scenes_redkitchen")
    default = source.calibration
    mirrored = default.depth_from_color.copy()
    mirrored[0, 3] *= -1
    offset = np.eye(4)
    offset[0, 3] = 0.025
    others = (
        Calibration(default.color, default.depth, mirrored),
        Calibration(Camera(640, 480, 539.5, 538.8, 320.0, 240.0), default.depth, offset),
        Calibration.registered(default.depth),
    )
    pairs = [(source.frame(i), source.frame(i + 12)) for i in (20, 90, 160)]

    def error(calibration: Calibration) -> float:
        return sum(color_error(calibration, *pair) for pair in pairs)

    assert all(error(default) < 0.97 * error(other) for other in others)
