from __future__ import annotations

import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, pose_from_quaternion
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.scannet_sens import ScannetSensSource
from recorders.registry import FORMATS
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.scannet_sens import (
    FIRST_US,
    LOST,
    PERIOD_US,
    SMALL,
    WIDE,
    room_sens,
    sens_frame,
    sens_header,
    small_sens,
)


def test_the_room_comes_back(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    source = ScannetSensSource(room_sens(tmp_path / "room.sens", room, room_frames))
    assert (
        FORMATS["scannet-sens"].recognise(tmp_path / "room.sens")
        == "is a .sens stream of version 4"
    )
    assert source.warnings == ()
    assert source.notes == {"frames without a pose": "0"}
    for image in ("color", "depth"):
        found, put = getattr(source.calibration, image), getattr(room.calibration, image)
        assert (found.width, found.height) == (put.width, put.height)
        np.testing.assert_allclose(found.k_integer_centres, put.k_integer_centres, rtol=1e-6)
    np.testing.assert_array_equal(source.calibration.depth_from_color, np.eye(4))
    frame = source.frame(2)
    assert frame.depth.dtype == np.uint16
    assert frame.stamp_ns == (FIRST_US + 2 * PERIOD_US) * 1000
    assert frame.color_stamp_ns == frame.stamp_ns - 5_000_000
    assert_round_trip(source, room_frames, tmp_path / "room.mcap")


def test_frames_are_the_same_in_any_order_and_thread(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    source = ScannetSensSource(room_sens(tmp_path / "room.sens", room, room_frames))
    order = [5, 0, 3, 1, 4, 2] * 4
    with ThreadPoolExecutor(4) as threads:
        for index, frame in zip(order, threads.map(source.frame, order), strict=True):
            assert frame.color == room_frames[index].color
            np.testing.assert_array_equal(frame.depth, room_frames[index].depth)


@pytest.mark.parametrize("lost", [LOST, np.full((4, 4), np.nan), np.zeros((4, 4))])
def test_frames_that_lost_tracking_are_left_out(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame], lost: np.ndarray
) -> None:
    frames = list(room_frames)
    frames[1] = replace(frames[1], world_from_camera=lost)
    source = ScannetSensSource(room_sens(tmp_path / "room.sens", room, frames))
    assert source.notes == {"frames without a pose": "1"}
    assert source.frame(1).stamp_ns == (FIRST_US + 2 * PERIOD_US) * 1000
    assert_round_trip(source, [frames[i] for i in (0, 2, 3, 4, 5)], tmp_path / "room.mcap")


def test_without_any_pose(tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]) -> None:
    lost = [replace(frame, world_from_camera=LOST) for frame in room_frames]
    path = room_sens(tmp_path / "room.sens", room, lost)
    with pytest.raises(ProgroundError, match=r"room\.sens: none of its 6 frames has a pose"):
        ScannetSensSource(path)


def test_times_that_do_not_ascend_give_way_to_the_frame_rate(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    frames = [replace(room_frames[0], world_from_camera=LOST), *room_frames[1:]]
    source = ScannetSensSource(room_sens(tmp_path / "room.sens", room, frames, period_us=0))
    assert source.notes["times"].startswith("30 Hz by number")
    frame = source.frame(1)
    assert frame.stamp_ns == frame.color_stamp_ns == 2 * 10**9 // 30


@pytest.mark.parametrize("codings", [(0, 0), (0, 1), (1, 0), (2, 1)])
def test_codings_and_sizes_of_colour_and_depth(tmp_path: Path, codings: tuple[int, int]) -> None:
    source = ScannetSensSource(small_sens(tmp_path / "small.sens", codings=codings))
    assert (source.calibration.color, source.calibration.depth) == (WIDE, SMALL)
    rng = np.random.default_rng(3)
    for frame in map(source.frame, range(3)):
        pixels = rng.integers(0, 256, (14, 20, 3), dtype=np.uint8)
        assert frame.color_format == ("jpeg" if codings[0] == 2 else "png")
        if codings[0] == 0:
            np.testing.assert_array_equal(frame.decode_color(), pixels)
        np.testing.assert_array_equal(frame.depth, rng.integers(0, 9000, (12, 16)))


def test_another_unit_of_depth(tmp_path: Path) -> None:
    millimetres = ScannetSensSource(small_sens(tmp_path / "a.sens")).frame(0).depth
    depth = ScannetSensSource(small_sens(tmp_path / "b.sens", depth_per_m=4000.0)).frame(0).depth
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, millimetres / 4000, rtol=1e-6)


def test_extrinsics_lead_to_the_base(tmp_path: Path) -> None:
    base_from_color, base_from_depth = (
        pose_from_quaternion(np.array(at), np.array([0.1, 0.2, 0.0, 0.97]))
        for at in ((0.0, 0.01, 0.0), (0.025, 0.0, 0.003))
    )
    path = small_sens(tmp_path / "a.sens", extrinsics=(base_from_color, base_from_depth))
    found = ScannetSensSource(path).calibration.depth_from_color
    # A point of the colour camera and the same one of the depth camera meet in the base.
    point = np.array([0.3, -0.2, 1.5, 1.0])
    np.testing.assert_allclose(base_from_depth @ found @ point, base_from_color @ point, atol=1e-6)


def test_a_calibration_takes_the_place_of_the_files(tmp_path: Path) -> None:
    path = small_sens(tmp_path / "a.sens", extrinsics=(np.zeros((4, 4)), np.eye(4)))
    with pytest.raises(ProgroundError, match=r"a\.sens, color camera: the pose is not rigid"):
        ScannetSensSource(path)
    own = Calibration(WIDE, SMALL, np.eye(4))
    assert ScannetSensSource(path, calibration=own).calibration == own
    other = Calibration.registered(SMALL)
    with pytest.raises(ProgroundError, match=r"a\.sens, frame 0: is 20x14, but the calibration"):
        ScannetSensSource(path, calibration=other).frame(0)


@pytest.mark.parametrize(("cut", "whole"), [(9, 5), (-1, 2)])
def test_a_file_cut_short_gives_its_whole_frames(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame], cut: int, whole: int
) -> None:
    path = room_sens(tmp_path / "room.sens", room, room_frames)
    content = path.read_bytes()
    third = content.index(room_frames[2].color)
    path.write_bytes(content[: -cut - 8] if cut > 0 else content[: third - 50])
    source = ScannetSensSource(path)
    assert len(source) == whole
    (warning,) = source.warnings
    assert warning.startswith(f"{path}: is cut short, only {whole} of its 6 frames are whole")
    assert_round_trip(source, room_frames[:whole], tmp_path / "room.mcap")


BEFORE_FRAMES = len(sens_header(WIDE, SMALL, 1))
NUMBERS = BEFORE_FRAMES - 36
"""Where the codings, sizes, unit and count are."""


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (0, struct.pack("<I", 3), "is not a .sens stream of version 4"),
        (4, struct.pack("<Q", 2**40), "name of 1099511627776 characters"),
        (NUMBERS, struct.pack("<i", -1), "unknown coding of color, -1"),
        (NUMBERS + 4, struct.pack("<i", 2), "occi"),
        (NUMBERS + 4, struct.pack("<i", 7), "unknown coding of depth, 7"),
        (NUMBERS + 8, struct.pack("<II", 2**31, 2**31), "color images of 2147483648x2147483648"),
        (NUMBERS + 20, struct.pack("<I", 0), "depth images of 16x0"),
        (NUMBERS + 24, struct.pack("<f", np.nan), "nan units of depth"),
        (NUMBERS + 28, struct.pack("<Q", 0), "says that it has 0 frames"),
        (NUMBERS + 28, struct.pack("<Q", 2**63), "says that it has 9223372036854775808 frames"),
        (NUMBERS + 8, struct.pack("<I", 10), r"color camera: has the intrinsics .* 10x14"),
        (BEFORE_FRAMES, struct.pack("<f", 3.0), "frame 0: the pose is not rigid"),
        (BEFORE_FRAMES + 80, struct.pack("<Q", 2**62), "frame 0: has a color image of 4611686"),
        (BEFORE_FRAMES + 88, struct.pack("<Q", 0), "frame 0: has a depth image of 0 bytes"),
    ],
)
def test_what_is_wrong_is_found_on_opening(
    tmp_path: Path, at: int, value: bytes, message: str
) -> None:
    path = small_sens(tmp_path / "bad.sens")
    content = bytearray(path.read_bytes())
    content[at : at + len(value)] = value
    path.write_bytes(content)
    with pytest.raises(ProgroundError, match=message) as caught:
        ScannetSensSource(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (0, "is not a .sens"),
        (40, "is cut short within its header"),
        (BEFORE_FRAMES, "is cut short within its first frame"),
        (BEFORE_FRAMES + 150, "is cut short within its first frame"),
    ],
)
def test_a_file_without_a_whole_frame(tmp_path: Path, size: int, message: str) -> None:
    path = small_sens(tmp_path / "cut.sens")
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ProgroundError, match=rf"cut\.sens: {message}"):
        ScannetSensSource(path)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="no such file"):
        ScannetSensSource(tmp_path / "none.sens")


@pytest.mark.parametrize(
    ("depth", "codings", "message"),
    [
        (zlib.compress(bytes(10**7)), (2, 1), "not the 384 bytes of 16x12"),
        (zlib.compress(bytes(382)), (2, 1), "not the 384 bytes"),
        (zlib.compress(bytes(384))[:-1], (2, 1), "not the 384 bytes"),
        (b"no zlib", (2, 1), "cannot be decompressed"),
        (bytes(383), (2, 0), "not the 384 bytes"),
    ],
)
def test_broken_depth_is_named_by_its_frame(
    tmp_path: Path, depth: bytes, codings: tuple[int, int], message: str
) -> None:
    color = cv2.imencode(".jpg", np.zeros((14, 20, 3), np.uint8))[1].tobytes()
    path = tmp_path / "bad.sens"
    content = sens_header(WIDE, SMALL, 1, codings=codings)
    path.write_bytes(content + sens_frame(np.eye(4), color, depth))
    with pytest.raises(ProgroundError, match=rf"bad\.sens, frame 0: .*{message}"):
        ScannetSensSource(path).frame(0)


@pytest.mark.parametrize(("coding", "message"), [(0, "not 20x14 RGB"), (2, "not a readable image")])
def test_broken_colour_is_named_by_its_frame(tmp_path: Path, coding: int, message: str) -> None:
    path = tmp_path / "bad.sens"
    content = sens_header(WIDE, SMALL, 1, codings=(coding, 0))
    path.write_bytes(content + sens_frame(np.eye(4), b"colour", bytes(384)))
    with pytest.raises(ProgroundError, match=rf"bad\.sens, frame 0: .*{message}"):
        ScannetSensSource(path).frame(0)


def test_damage_never_gets_past_the_recorder(tmp_path: Path) -> None:
    whole = small_sens(tmp_path / "whole.sens", count=2).read_bytes()
    path = tmp_path / "damaged.sens"
    rng = np.random.default_rng(17)
    refused = []
    for _ in range(600):
        content = bytearray(whole)
        # Headers are a small part of the bytes, and most of what is read from them.
        reach = len(whole) if rng.random() < 0.3 else BEFORE_FRAMES + 96
        for at in rng.integers(0, reach, rng.integers(1, 5)):
            content[at] = rng.integers(0, 256)
        if rng.random() < 0.2:
            del content[rng.integers(0, len(content)) :]
        path.write_bytes(content)
        try:
            source = ScannetSensSource(path)
            for frame in map(source.frame, range(len(source))):
                assert frame.depth.shape == (
                    source.calibration.depth.height,
                    source.calibration.depth.width,
                )
                assert np.isfinite(frame.depth_m).all()
        except ProgroundError as error:
            refused.append(str(error))
    assert 100 < len(refused) < 600
    assert all(str(path) in message for message in refused)


def test_other_paths_are_not_recognised(tmp_path: Path) -> None:
    (tmp_path / "old.sens").write_bytes(struct.pack("<I", 3) + bytes(99))
    (tmp_path / "tiny.sens").write_bytes(b"\4")
    (tmp_path / "folder.sens").mkdir()
    small_sens(tmp_path / "other.bin")
    for name in (
        "old.sens",
        "tiny.sens",
        "folder.sens",
        "other.bin",
        "none.sens",
        "",
        "nul\0.sens",
    ):
        assert FORMATS["scannet-sens"].recognise(tmp_path / name) is None
