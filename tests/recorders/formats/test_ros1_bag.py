from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.ros import ros1_bag
from recorders.formats.ros.ros1_bag import TF_DEFINITION, Ros1BagSource, recognise
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.ros_bags import TF, Sent, room_messages


def write_bag(path: Path, sent: list[Sent], compression: str | None = None) -> Path:
    """Write a ROS 1 bag of the same messages."""
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    store.register(typesys.get_types_from_msg(TF_DEFINITION, TF))
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(writer.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for topic, its_type, stamp_ns, message in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, its_type, typestore=store)
            built = in_ros1(store, its_type, message)
            writer.write(connections[topic], stamp_ns, store.serialize_ros1(built, its_type))
    return path


def in_ros1(store: Any, its_type: str, message: Any) -> Any:
    """The message as ROS 1 has it: headers count, and a camera's matrices have capital names."""
    _, fields = store.fielddefs[its_type]
    values = {}
    for name, (kind, of) in fields:
        value = 0 if name == "seq" else getattr(message, name, None)
        if value is None:
            value = getattr(message, name.lower())
        if kind.name == "NAME" and its_type == "std_msgs/msg/Header" and name == "stamp":
            value = store.types[of](sec=value.sec, nanosec=value.nanosec)
        elif kind.name == "NAME":
            value = in_ros1(store, of, value)
        elif kind.name in ("ARRAY", "SEQUENCE"):
            element_kind, element = of[0]
            if element_kind.name == "NAME":
                value = [in_ros1(store, element, each) for each in value]
            elif isinstance(value, bytes):
                value = np.frombuffer(value, np.uint8)
            else:
                value = np.array(value, dtype=element[0])
        elif name == "frame_id":
            value = f"/{value}"
        values[name] = value
    return store.types[its_type](**values)


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
    assert recognise(write_bag(tmp_path / "room.bag", sent)) == "begins with #ROSBAG V2.0"
    (tmp_path / "other.bag").write_bytes(b"#ROSBAG V1.2\n")
    for path in (tmp_path, tmp_path / "other.bag", tmp_path / "nothing", room_log):
        assert recognise(path) is None
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
