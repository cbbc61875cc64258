from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.scannetpp import ScannetppSource, recognise
from recorders.formats.scannetpp_depth import HEIGHT, WIDTH, open_depth
from recorders.reading import forward
from recorders.reading.forward import ForwardImages
from recorders.room import RoomSource
from recorders.source import Source
from tests.round_trip import assert_round_trip
from tests.writers.scannetpp import (
    CODINGS,
    deflate,
    iphone_frame,
    lz4_records,
    one_deflate,
    poses_of,
    record,
    write_iphone,
    write_video,
)


@pytest.fixture(scope="module")
def frames(room_frames: list[SensorFrame]) -> list[SensorFrame]:
    return [iphone_frame(frame) for frame in room_frames]


@pytest.fixture
def poses(frames: list[SensorFrame], room: RoomSource) -> dict[str, Any]:
    return poses_of(frames, room.calibration.color)


@pytest.fixture
def iphone(tmp_path: Path, frames: list[SensorFrame], poses: dict[str, Any]) -> Path:
    return write_iphone(tmp_path / "02455b3d20/iphone", frames, poses)


@pytest.mark.parametrize("coding", CODINGS)
def test_round_trip(
    iphone: Path,
    frames: list[SensorFrame],
    coding: str,
    depth_agreement: Callable[[Source, SensorFrame, SensorFrame, float], float],
) -> None:
    (iphone / "depth.bin").write_bytes(CODINGS[coding](frames))
    source = ScannetppSource(iphone.parent)
    assert source.calibration.color == Camera(320, 240, 200.0, 200.0, 160.0, 120.0)
    assert source.calibration.depth == Camera(256, 192, 160.0, 160.0, 128.0, 96.0)
    log = assert_round_trip(source, frames, iphone / "room.mcap", same_bytes=False)
    assert log.stamps_ns() == [8123_500000000 + i * 15_625_000 for i in range(6)]
    assert source.frame(0).depth.dtype == (np.uint16 if coding == "lz4" else np.float32)
    assert depth_agreement(source, source.frame(0), source.frame(5), 0.05) > 0.9
    assert source.notes == {"frames without a pose": "0", "images without a partner": "0"}
    assert source.ground_truth_mesh() is None


def test_times_are_exact(iphone: Path, poses: dict[str, Any]) -> None:
    for name, frame in poses.items():
        frame["timestamp"] = name
    text = json.dumps(poses)
    for number in range(6):
        # More digits than a float has.
        text = text.replace(f': "frame_{number:06d}"', f": 812345678.01666700{number}0")
    (iphone / "pose_intrinsic_imu.json").write_text(text)
    source = ScannetppSource(iphone)
    stamps_ns = [source.frame(i).stamp_ns for i in range(6)]
    assert stamps_ns == [812345678_016667000 + i for i in range(6)]


@pytest.mark.parametrize("coding", CODINGS)
def test_threads_in_any_order_read_the_same(
    iphone: Path, frames: list[SensorFrame], coding: str
) -> None:
    (iphone / "depth.bin").write_bytes(CODINGS[coding](frames))
    source = ScannetppSource(iphone)
    order = [int(i) for i in np.random.default_rng(0).integers(0, 6, 40)]
    with ThreadPoolExecutor(4) as executor:
        for index, frame in zip(order, executor.map(source.frame, order), strict=True):
            np.testing.assert_array_equal(frame.depth_m, frames[index].depth_m)
            np.testing.assert_array_equal(frame.decode_color(), frames[index].decode_color())


def test_frames_have_their_own_intrinsics(iphone: Path, poses: dict[str, Any]) -> None:
    poses["frame_000004"]["intrinsic"][0] = [210.0, 0.0, 165.0]
    (iphone / "pose_intrinsic_imu.json").write_text(json.dumps(poses))
    source = ScannetppSource(iphone)
    own = source.frame(4).calibration
    assert own is not None
    assert own.color == Camera(320, 240, 210.0, 200.0, 165.0, 120.0)
    assert own.depth == Camera(256, 192, 168.0, 160.0, 132.0, 96.0)
    assert source.frame(3).calibration is None
    given = Calibration(own.color, own.depth, np.eye(4))
    assert ScannetppSource(iphone, calibration=given).frame(4).calibration is None


def test_frames_without_a_pose_or_depth_are_skipped(
    iphone: Path, frames: list[SensorFrame], poses: dict[str, Any]
) -> None:
    del poses["frame_000001"]["aligned_pose"]
    poses["frame_000002"]["aligned_pose"][0][3] = float("nan")
    poses["frame_000003"]["aligned_pose"] = np.diag([2, 2, 2, 1]).tolist()
    (iphone / "pose_intrinsic_imu.json").write_text(json.dumps(poses))
    (iphone / "depth.bin").write_bytes(lz4_records(frames[:5]))
    source = ScannetppSource(iphone)
    assert len(source) == 2
    assert source.notes == {"frames without a pose": "3", "images without a partner": "1"}
    np.testing.assert_array_equal(source.frame(1).depth, frames[4].depth)


def test_depth_that_is_cut_off_is_kept_up_to_there(iphone: Path, frames: list[SensorFrame]) -> None:
    (iphone / "depth.bin").write_bytes(lz4_records(frames)[:-7])
    source = ScannetppSource(iphone)
    assert len(source) == 5
    assert source.warnings == ("depth.bin is cut off after 5 frames: copy it again",)
    (iphone / "depth.bin").write_bytes(one_deflate(frames)[:-7])
    source = ScannetppSource(iphone)
    np.testing.assert_array_equal(source.frame(4).depth, frames[4].depth_m)
    with pytest.raises(ProgroundError, match=r"depth\.bin, frame 5: the depth stream is broken"):
        source.frame(5)
    (iphone / "depth.bin").write_bytes(one_deflate(frames[:2]))
    with pytest.raises(ProgroundError, match="ends after 2 frames, before frame 3"):
        ScannetppSource(iphone).frame(3)


def test_a_film_that_ends_early_is_named(iphone: Path, frames: list[SensorFrame]) -> None:
    write_video(iphone / "rgb.mkv", frames[:3])
    source = ScannetppSource(iphone)
    assert source.frame(2).color_format == "png"
    with pytest.raises(ProgroundError, match=r"rgb\.mkv: ends after 3 frames, before frame 4"):
        source.frame(4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"timestamp": None}, "frame_000001: 'None' is not a time"),
        ({"timestamp": 0}, "frame_000001: has no later time than the frame before"),
        ({"intrinsic": [1, 2]}, "frame_000001: intrinsic is not 3 x 3 numbers"),
        ({"intrinsic": [[0] * 3] * 3}, "frame_000001: the focal lengths have to be"),
    ],
)
def test_a_broken_frame_is_named(
    iphone: Path, poses: dict[str, Any], change: Any, message: str
) -> None:
    poses["frame_000001"] |= change
    (iphone / "pose_intrinsic_imu.json").write_text(json.dumps(poses))
    with pytest.raises(ProgroundError, match=rf"pose_intrinsic_imu\.json, {message}"):
        ScannetppSource(iphone)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("pose_intrinsic_imu.json", b"{", "is not JSON"),
        ("pose_intrinsic_imu.json", b"[]", "no frame: of 0"),
        ("depth.bin", b"", "in neither coding"),
        ("depth.bin", bytes(1000), "in neither coding"),
        ("depth.bin", record(b"no depth") * 9, "in neither coding"),
        ("depth.bin", b"\xff" * 100, "in neither coding"),
        ("depth.bin", record(deflate(bytes(10**7))), "in neither coding"),
        ("rgb.mkv", b"#EXTM3U\n#EXTINF:1,\n/etc/passwd\n", "cannot be opened as a video"),
        ("rgb.mkv", b"\x1aE\xdf\xa3 and nothing else", "cannot be opened as a video"),
    ],
)
def test_a_broken_file_is_named(iphone: Path, name: str, content: bytes, message: str) -> None:
    (iphone / name).write_bytes(content)
    with pytest.raises(ProgroundError, match=message) as caught:
        ScannetppSource(iphone)
    assert str(iphone) in str(caught.value)


@pytest.mark.parametrize("name", ["pose_intrinsic_imu.json", "depth.bin", "rgb.mkv"])
def test_a_missing_file_is_named(iphone: Path, name: str) -> None:
    (iphone / name).unlink()
    with pytest.raises(ProgroundError, match=name):
        ScannetppSource(iphone)


def test_recognise(iphone: Path, tmp_path: Path) -> None:
    assert recognise(iphone) == "has pose_intrinsic_imu.json and depth.bin"
    assert recognise(iphone.parent) == "has pose_intrinsic_imu.json and depth.bin"
    assert recognise(tmp_path) is None
    assert recognise(iphone / "depth.bin") is None
    assert recognise(tmp_path / "missing") is None
    assert recognise(Path("a\0b")) is None


def test_mutated_depth_is_an_error_or_an_image(tmp_path: Path, frames: list[SensorFrame]) -> None:
    """The codings have no checksums: what can be decoded cannot be told from depth."""
    rng = np.random.default_rng(9)
    path, refused = tmp_path / "depth.bin", []
    for whole in (coding(frames[:2]) for coding in CODINGS.values()):
        for _ in range(60):
            data = bytearray(whole)
            for at in rng.integers(0, len(data), 2):
                data[at] ^= 1 << rng.integers(0, 8)
            path.write_bytes(data[: rng.integers(0, len(data))] if rng.random() < 0.2 else data)
            try:
                stream = open_depth(path)
                for number in range(2 if stream.frames is None else stream.frames):
                    depth = stream.at(number)
                    assert depth.shape == (HEIGHT, WIDTH)
                    assert np.isfinite(depth).all()
                    assert (depth >= 0).all()
            except ProgroundError as error:
                refused.append(error.where)
    assert len(refused) > 20
    assert all(where.startswith(str(path)) for where in refused)


def test_forward_images_are_read_on_rather_than_anew() -> None:
    started = []

    def start() -> forward.Images:
        started.append(None)
        return iter([lambda n=n: np.array(n) for n in range(100)])

    images = ForwardImages(start, "film")
    # A little out of order, as threads ask.
    for number in (1, 0, 2, 4, 3, 7, 5, 6, 9, 8, 50, 49, 51, 99, 98):
        assert images.at(number) == number
    assert len(started) <= forward.READERS
    with pytest.raises(ProgroundError, match="film: ends after 100 frames, before frame 100"):
        images.at(100)
    assert images.at(0) == 0
