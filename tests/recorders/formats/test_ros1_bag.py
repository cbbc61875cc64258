from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.ros import ros1_bag
from recorders.formats.ros.ros1_bag import Ros1BagSource
from recorders.registry import FORMATS
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.ros1_bag import write_bag
from tests.writers.ros_bags import Sent, room_messages


@pytest.fixture(scope="session")
def sent(room: RoomSource, room_frames: list[SensorFrame]) -> list[Sent]:
    return room_messages(room_frames, room.calibration.depth)


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_a_bag_comes_back_exactly(
    compression: str | None,
    sent: list[Sent],
    room: RoomSource,
    room_frames: list[SensorFrame],
    tmp_path: Path,
) -> None:
    source = Ros1BagSource(write_bag(tmp_path / "room.bag", sent, compression))
    assert_round_trip(source, room_frames, tmp_path / "log.mcap")
    assert source.calibration == room.calibration
    assert source.notes["poses"] == "of camera_depth_optical_frame in map, by tf"
    order = [5, 0, 3, 1, 4, 2]
    with ThreadPoolExecutor(4) as executor:
        for index, frame in zip(order, executor.map(source.frame, order), strict=True):
            np.testing.assert_array_equal(frame.depth, room_frames[index].depth)


def test_recognise(sent: list[Sent], tmp_path: Path, room_log: Path) -> None:
    assert (
        FORMATS["ros1-bag"].recognise(write_bag(tmp_path / "room.bag", sent))
        == "begins with #ROSBAG V2.0"
    )
    (tmp_path / "other.bag").write_bytes(b"#ROSBAG V1.2\n")
    for path in (tmp_path, tmp_path / "other.bag", tmp_path / "nothing", room_log):
        assert FORMATS["ros1-bag"].recognise(path) is None
    with pytest.raises(ProgroundError, match=r"other\.bag: is no ROS 1 bag of version 2\.0"):
        Ros1BagSource(tmp_path / "other.bag")
    with pytest.raises(ProgroundError, match="no such file"):
        Ros1BagSource(tmp_path / "nothing")


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_chunk_that_unpacks_to_too_much_is_refused(
    compression: str, sent: list[Sent], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / "room.bag", sent, compression)
    monkeypatch.setattr(ros1_bag, "LARGEST_CHUNK_BYTES", 10_000)
    with pytest.raises(ProgroundError, match="a chunk unpacks to more than 10000 bytes"):
        Ros1BagSource(path)


def test_without_the_package_its_installation_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "room.bag").write_bytes(b"#ROSBAG V2.0\n")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(ProgroundError, match=r"pip install 'proground-log\[ros1\]'"):
        Ros1BagSource(tmp_path / "room.bag")


def test_a_damaged_bag_gives_an_error_or_a_frame(sent: list[Sent], tmp_path: Path) -> None:
    path = write_bag(tmp_path / "room.bag", sent)
    rng, whole, errors = np.random.default_rng(4), path.read_bytes(), 0
    for number in range(32):
        data = bytearray(whole)
        for at in rng.integers(0, len(data) if number % 2 else 6000, 4):
            data[-at if number % 4 else at] ^= 1 << rng.integers(8)
        path.write_bytes(data if number % 8 else data[: rng.integers(len(data))])
        try:
            source = Ros1BagSource(path)
            assert source.frame(len(source) - 1).depth.shape == (240, 320)
        except ProgroundError:
            errors += 1
    assert errors > 10
