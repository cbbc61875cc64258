from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.arkitscenes import ArkitscenesSource, recognise
from recorders.room import RoomSource
from recorders.source import Source
from tests.round_trip import assert_round_trip
from tests.writers.arkitscenes import START_S, VIDEO, png, small_frame, stamp, write_video


@pytest.fixture(scope="module")
def frames(room_frames: list[SensorFrame]) -> list[SensorFrame]:
    return [small_frame(frame) for frame in room_frames]


@pytest.fixture
def video(tmp_path: Path, frames: list[SensorFrame], room: RoomSource) -> Path:
    write_video(tmp_path / VIDEO, frames, room.calibration.color)
    return tmp_path / VIDEO


def test_round_trip(
    video: Path,
    frames: list[SensorFrame],
    depth_agreement: Callable[[Source, SensorFrame, SensorFrame, float], float],
) -> None:
    source = ArkitscenesSource(video)
    # Scaled about the image's corner, from which Apple counts.
    assert source.calibration.color == Camera(320, 240, 200.0, 200.0, 160.0, 120.0)
    assert source.calibration.depth == Camera(160, 120, 100.0, 100.0, 80.0, 60.0)
    log = assert_round_trip(source, frames, video.with_suffix(".mcap"))
    assert log.stamps_ns() == [START_S * 10**9 + i * 10**8 for i in range(6)]
    assert [(f.calibration or log.calibration).color.fx for f in log.frames()] == [200] * 3 + [
        201
    ] * 3
    assert source.frame(2).calibration is None
    assert depth_agreement(source, source.frame(0), source.frame(2), 0.05) > 0.9
    assert source.notes == {
        "images without a partner": "0",
        "frames without a pose": "0",
        "depth left out": "of a confidence below 1",
    }
    assert source.ground_truth_mesh() is None


def test_the_layout_of_3dod(video: Path) -> None:
    outer = video.with_name("outer")
    outer.mkdir()
    video.rename(outer / f"{VIDEO}_frames")
    assert len(ArkitscenesSource(outer)) == 6
    assert recognise(outer) == "has lowres_wide.traj and lowres_depth"


def test_poses_are_interpolated_and_not_beyond_a_gap(
    video: Path, frames: list[SensorFrame]
) -> None:
    path = video / "lowres_wide.traj"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[2], lines[2], lines[5]]))
    source = ArkitscenesSource(video)
    assert source.notes["frames without a pose"] == "2"
    stamps = [source.frame(i).stamp_ns - START_S * 10**9 for i in range(4)]
    assert stamps == [0, 10**8, 2 * 10**8, 5 * 10**8]
    first, middle, last = (source.frame(i).world_from_camera for i in range(3))
    np.testing.assert_allclose(middle[:3, 3], (first[:3, 3] + last[:3, 3]) / 2, atol=1e-9)
    np.testing.assert_allclose(last, frames[2].world_from_camera, atol=1e-9)


def test_images_without_a_partner_are_skipped(video: Path) -> None:
    next((video / "lowres_wide").glob(f"*_{stamp(1)}.png")).unlink()
    next((video / "lowres_wide_intrinsics").glob(f"*_{stamp(4)}.pincam")).unlink()
    source = ArkitscenesSource(video)
    assert len(source) == 4
    assert source.notes["images without a partner"] == "2"


def test_low_confidence_is_not_depth(video: Path, frames: list[SensorFrame]) -> None:
    confidence = np.full(frames[0].depth.shape, 2, np.uint8)
    confidence[5], confidence[6] = 0, 1
    (video / f"confidence/{VIDEO}_{stamp(0)}.png").write_bytes(png(confidence))
    for minimum, dropped in ((0, []), (1, [5]), (2, [5, 6])):
        wanted = frames[0].depth.copy()
        wanted[dropped] = 0
        found = ArkitscenesSource(video, min_confidence=minimum).frame(0).depth
        np.testing.assert_array_equal(found, wanted)
        assert found.dtype == np.uint16
    (video / f"confidence/{VIDEO}_{stamp(0)}.png").unlink()
    assert (ArkitscenesSource(video).frame(0).depth[5] > 0).any()


def test_other_folders_of_raw(video: Path, room_frames: list[SensorFrame]) -> None:
    for name, pixels in (
        ("wide", room_frames[2].decode_color()),
        ("highres_depth", room_frames[2].depth),
    ):
        (video / name).mkdir()
        (video / f"{name}/{VIDEO}_{stamp(2)}.png").write_bytes(png(pixels))
    (video / "wide_intrinsics").mkdir()
    pincam = video / f"wide_intrinsics/{VIDEO}_{stamp(2)}.pincam"
    pincam.write_text("320 240 200 200 160 120")
    source = ArkitscenesSource(video, color="wide", depth="highres_depth")
    assert len(source) == 1
    assert source.calibration.is_registered
    # The LiDAR's confidence says nothing about a laser scanner.
    np.testing.assert_array_equal(source.frame(0).depth, room_frames[2].depth)


def test_a_given_calibration_is_for_all_frames(video: Path) -> None:
    given = Calibration(
        Camera(320, 240, 210.0, 210.0, 160.0, 120.0),
        Camera(160, 120, 105.0, 105.0, 80.0, 60.0),
        np.eye(4),
    )
    source = ArkitscenesSource(video, calibration=given)
    assert source.calibration is given
    assert source.frame(5).calibration is None


@pytest.mark.parametrize("name", ["lowres_wide", "lowres_depth", "lowres_wide_intrinsics"])
def test_a_missing_folder_is_named(video: Path, name: str) -> None:
    (video / name).rename(video / "elsewhere")
    with pytest.raises(ProgroundError, match=f"{name}: no such folder"):
        ArkitscenesSource(video)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"\.traj: has no poses"),
        ("6845.0 0 0 0 1 1\n", r"\.traj:1: is not 7 numbers"),
        ("\n6845.0 0 0 0 1 1 nan\n", r"\.traj:2: is not 7 numbers"),
        ("6845.0 0 0 0 1 1 1\n6845.0 0 0 0 1 1 2\n", "another pose has the same time"),
        ("12.0 0 0 0 1 1 1\n", "no frame: of 6 depth images, 6 have a colour image"),
    ],
)
def test_a_broken_trajectory_is_named(video: Path, text: str, message: str) -> None:
    (video / "lowres_wide.traj").write_text(text)
    with pytest.raises(ProgroundError, match=message) as caught:
        ArkitscenesSource(video)
    assert str(video) in str(caught.value)


def test_no_trajectory(video: Path) -> None:
    (video / "lowres_wide.traj").unlink()
    with pytest.raises(ProgroundError, match=r"lowres_wide\.traj: no such file"):
        ArkitscenesSource(video)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("320 240 200 200 160", "is not 6 numbers"),
        ("320 240 0 200 160 120", "above 0"),
        ("320 100 200 200 160 120", "depth of 160x120 has not the shape"),
    ],
)
def test_broken_intrinsics_are_named(video: Path, text: str, message: str) -> None:
    path = next((video / "lowres_wide_intrinsics").glob(f"*_{stamp(4)}.pincam"))
    path.write_text(text)
    source = ArkitscenesSource(video)
    with pytest.raises(ProgroundError, match=message) as caught:
        source.frame(4)
    assert stamp(4) in str(caught.value)


@pytest.mark.parametrize("folder", ["lowres_wide", "lowres_depth", "confidence"])
def test_a_truncated_image_is_named(video: Path, folder: str) -> None:
    path = video / f"{folder}/{VIDEO}_{stamp(3)}.png"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ProgroundError, match=str(path)):
        ArkitscenesSource(video).frame(3)


def test_recognise(video: Path) -> None:
    assert recognise(video) == "has lowres_wide.traj and lowres_depth"
    assert recognise(video / "lowres_wide.traj") is None
    assert recognise(video.parent) is None
    assert recognise(video / "missing") is None
    assert recognise(Path("a\0b")) is None
