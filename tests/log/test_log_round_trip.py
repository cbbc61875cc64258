"""What goes into a log comes out of it, byte for byte."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, DataEnd, Footer
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.log import topics
from proground_log.log.info import log_info
from proground_log.log.messages import DEFINITIONS
from proground_log.log.reader import LogReader
from proground_log.log.recording import Origin, Recording
from proground_log.log.writer import open_writer
from tests.log.rosidl_names import DEFINED_TYPES
from tests.writers.small_source import (
    BOUNDS,
    CAMERA,
    LABEL_NAMES,
    MESH,
    SmallSource,
    with_frame,
    write_log,
)

COLOR = Camera(40, 30, 38.5, 38.25, 20.125, 14.875, (0.1, -0.05, 0.002, -0.001, 0.01))
DEPTH_FROM_COLOR = np.eye(4)
DEPTH_FROM_COLOR[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 0.03]).as_matrix()
DEPTH_FROM_COLOR[:3, 3] = 0.025, -0.001, 0.0005
RIG = Calibration(COLOR, CAMERA, DEPTH_FROM_COLOR)


@pytest.mark.parametrize("in_metres", [False, True])
@pytest.mark.parametrize("color_format", ["png", "jpeg"])
def test_frames_come_back(tmp_path: Path, in_metres: bool, color_format: str) -> None:
    source = SmallSource(4, RIG, in_metres, with_labels=True, color_format=color_format)
    reader = LogReader(write_log(tmp_path / "a.mcap", source))
    frames = list(reader.frames())
    assert len(reader) == len(frames) == 4
    for index, frame in enumerate(frames):
        expected = source.frame(index)
        assert (frame.index, frame.stamp_ns) == (index, expected.stamp_ns)
        assert frame.color_stamp_ns == expected.color_stamp_ns
        assert bytes(frame.color) == expected.color
        assert frame.color_format == color_format
        assert frame.depth.dtype == (np.float32 if in_metres else np.uint16)
        np.testing.assert_array_equal(frame.depth, expected.depth)
        pose = expected.world_from_camera
        np.testing.assert_allclose(frame.world_from_camera, pose, rtol=0, atol=1e-9)
        assert frame.labels is not None
        assert frame.labels.dtype == np.uint16
        np.testing.assert_array_equal(frame.labels, expected.labels)


def test_what_a_log_says_about_itself_comes_back(tmp_path: Path) -> None:
    source = SmallSource(2, RIG, with_labels=True, notes={"left out": "3 frames, ümläut"})
    reader = LogReader(write_log(tmp_path / "a.mcap", source))
    assert reader.recording == Recording("small data", "small", 2, BOUNDS, source.notes)
    assert reader.calibration.color == COLOR
    assert reader.calibration.depth == CAMERA
    mount = reader.calibration.depth_from_color
    np.testing.assert_allclose(mount, DEPTH_FROM_COLOR, rtol=0, atol=1e-12)
    assert reader.label_names == LABEL_NAMES
    assert reader.attachment(topics.MESH_ATTACHMENT) == MESH
    assert reader.attachment("another") is None


def test_what_a_source_does_not_have_is_not_there(tmp_path: Path) -> None:
    reader = LogReader(write_log(tmp_path / "a.mcap"))
    assert reader.calibration.is_registered
    assert reader.label_names == {}
    assert reader.attachment(topics.MESH_ATTACHMENT) is None
    assert next(reader.frames()).labels is None
    counts = log_info(tmp_path / "a.mcap").messages
    assert counts.pop(topics.TF_STATIC) == 1
    assert set(counts) == {"/tf", topics.COLOR, topics.DEPTH, topics.COLOR_INFO, topics.DEPTH_INFO}
    assert set(counts.values()) == {5}


@settings(max_examples=30, deadline=None)
@given(
    rotation=st.tuples(*[st.floats(-4, 4)] * 3),
    position_m=st.tuples(*[st.floats(-1e4, 1e4)] * 3),
)
def test_any_pose_comes_back(
    rotation: tuple[float, float, float],
    position_m: tuple[float, float, float],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    pose[:3, 3] = position_m
    path = tmp_path_factory.mktemp("pose") / "a.mcap"
    write_log(path, frames=[replace(SmallSource().frame(0), world_from_camera=pose)])
    back = next(LogReader(path).frames()).world_from_camera
    np.testing.assert_allclose(back, pose, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(back[:3, 3], pose[:3, 3])


def test_extreme_values_come_back(tmp_path: Path) -> None:
    depth = np.array([[0, 1, 65534, 65535]], np.uint16).repeat(24, 0).repeat(8, 1)
    first = replace(SmallSource().frame(0), stamp_ns=0, color_stamp_ns=-5, depth=depth)
    last_ns = (2**31 - 1) * 1_000_000_000 + 999_999_999
    metres = np.array([[0, 1e-38, 3.4e38, 1.5]], np.float32).repeat(24, 0).repeat(8, 1)
    second = replace(first, stamp_ns=last_ns, color_stamp_ns=last_ns, depth=metres)
    path = write_log(tmp_path / "a.mcap", frames=[first, second])
    a, b = LogReader(path).frames()
    assert (a.stamp_ns, a.color_stamp_ns, b.stamp_ns, b.color_stamp_ns) == (0, -5, last_ns, last_ns)
    np.testing.assert_array_equal(a.depth, depth)
    np.testing.assert_array_equal(b.depth, metres)


def test_the_same_frames_make_the_same_bytes(tmp_path: Path) -> None:
    source = SmallSource(30, RIG, with_labels=True)
    first = write_log(tmp_path / "a.mcap", source).read_bytes()
    (tmp_path / "elsewhere").mkdir()
    assert write_log(tmp_path / "elsewhere" / "b.mcap", source).read_bytes() == first
    other = write_log(tmp_path / "c.mcap", replace(source, count=29)).read_bytes()
    assert other != first


@pytest.mark.parametrize("chosen", [[0], [3], [0, 2, 4], [4], range(1, 5), []])
def test_chosen_frames_are_those_of_all(tmp_path: Path, chosen: list[int]) -> None:
    reader = LogReader(write_log(tmp_path / "a.mcap"))
    frames = list(reader.frames(chosen))
    assert [frame.index for frame in frames] == list(chosen)
    every = list(reader.frames())
    for frame in frames:
        np.testing.assert_array_equal(frame.depth, every[frame.index].depth)


def test_a_frame_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", announced=6)
    with pytest.raises(ProgroundError, match=r"a\.mcap: frame 5 is missing, the log announces 6"):
        list(LogReader(path).frames())


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        (Selection(), [0, 1, 2, 3, 4]),
        (Selection(1, 4), [1, 2, 3]),
        (Selection(1, 99, 2), [1, 3]),
        (Selection(stride=4), [0, 4]),
    ],
)
def test_selections(selection: Selection, expected: list[int]) -> None:
    assert list(selection.of(5)) == expected


@pytest.mark.parametrize(
    "selection",
    [Selection(5), Selection(3, 3), Selection(3, 2), Selection(-1), Selection(stride=0)],
)
def test_selections_of_nothing(selection: Selection) -> None:
    message = r"of 5 frames: start .* select no frame; select frames between 0 and 4, with a stride"
    with pytest.raises(ProgroundError, match=message):
        selection.of(5)


# What other programs see.


def test_the_file_is_ros_2_with_zstd_and_every_checksum(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", SmallSource(60, RIG, with_labels=True))
    with path.open("rb") as stream:
        header = make_reader(stream).get_header()
        assert (header.profile, header.library) == ("ros2", "proground-log")
        stream.seek(0)
        records = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert len(chunks) >= 1
    assert {chunk.compression for chunk in chunks} == {"zstd"}
    assert all(chunk.uncompressed_crc for chunk in chunks)
    assert all(record.data_section_crc for record in records if isinstance(record, DataEnd))
    assert all(record.summary_crc for record in records if isinstance(record, Footer))
    assert Counter(map(type, records))[Footer] == 1


def test_log_time_tells_the_frame_and_never_runs_back(tmp_path: Path) -> None:
    source = SmallSource(7, with_labels=True)
    path = write_log(tmp_path / "a.mcap", source)
    with path.open("rb") as stream:
        found = list(NonSeekingReader(stream, True).iter_messages(log_time_order=False))
    keys = [(message.log_time, message.sequence) for _, _, message in found]
    assert keys == sorted(keys)
    assert sorted(set(keys)) == [(source.frame(i).stamp_ns, i) for i in range(7)]
    assert all(message.publish_time == message.log_time for _, _, message in found)
    topics_of_a_frame = Counter((message.sequence, channel.topic) for _, channel, message in found)
    assert set(topics_of_a_frame.values()) == {1}


def test_other_programs_decode_each_message_by_its_schema(tmp_path: Path) -> None:
    source = SmallSource(2, RIG, with_labels=True)
    path = write_log(tmp_path / "a.mcap", source)
    found = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert message.data[:4] == b"\x00\x01\x00\x00"  # CDR, little-endian.
            found.setdefault(channel.topic, decoded)
            qos = "offered_qos_profiles" in channel.metadata
            assert qos == (channel.topic == topics.TF_STATIC)
    frame = source.frame(0)
    color, depth, labels = (found[t] for t in (topics.COLOR, topics.DEPTH, topics.LABELS))
    assert (color.format, color.data) == ("png", frame.color)
    stamp = color.header.stamp
    assert stamp.sec * 1_000_000_000 + stamp.nanosec == frame.color_stamp_ns
    assert (depth.encoding, depth.width, depth.height, depth.step) == ("16UC1", 32, 24, 64)
    assert depth.data == frame.depth.tobytes()
    assert (labels.encoding, labels.width, labels.height) == ("mono16", 40, 30)
    info = found[topics.COLOR_INFO]
    np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), COLOR.k_integer_centres)
    assert (info.distortion_model, tuple(info.d)) == ("plumb_bob", COLOR.distortion)
    assert tuple(found[topics.DEPTH_INFO].d) == (0.0,) * 5
    assert color.header.frame_id == info.header.frame_id == labels.header.frame_id
    [pose], [mount] = found[topics.TF].transforms, found[topics.TF_STATIC].transforms
    assert (pose.header.frame_id, pose.child_frame_id) == ("world", depth.header.frame_id)
    assert mount.header.frame_id == depth.header.frame_id
    assert mount.child_frame_id == color.header.frame_id
    preview = found[topics.LABELS_PREVIEW]
    colors = cv2.imdecode(np.frombuffer(preview.data, np.uint8), cv2.IMREAD_COLOR)
    assert frame.labels is not None
    for label in (0, *LABEL_NAMES):
        assert len(np.unique(colors[frame.labels == label], axis=0)) == 1


@pytest.mark.parametrize("name", DEFINITIONS)
def test_each_schema_is_the_public_one_and_complete(name: str) -> None:
    parts = DEFINITIONS[name].split("=" * 80 + "\nMSG: ")
    packages = [name.replace("/msg/", "/")] + [part.splitlines()[0] for part in parts[1:]]
    assert len(set(packages)) == len(packages)
    for package, part in zip(packages, parts, strict=True):
        lines = part.splitlines()[int(part is not parts[0]) :]
        fields = [tuple(line.split()[:2]) for line in lines if line]
        assert fields == DEFINED_TYPES[package]
        for kind, _ in fields:
            base = kind.split("[")[0]
            assert "/" not in base or base in packages


# What a writer refuses.


@pytest.mark.parametrize("step_ns", [0, -1])
def test_time_that_does_not_increase_is_refused(tmp_path: Path, step_ns: int) -> None:
    source = SmallSource()
    frames = with_frame(source, 2, stamp_ns=source.frame(1).stamp_ns + step_ns)
    with pytest.raises(ProgroundError, match=r"^frame 2: its time, .* is not after"):
        write_log(tmp_path / "a.mcap", frames=frames)
    assert not (tmp_path / "a.mcap").exists()


def test_a_time_beyond_ros_is_refused(tmp_path: Path) -> None:
    frames = with_frame(SmallSource(), 4, stamp_ns=2**31 * 1_000_000_000)
    with pytest.raises(ProgroundError, match="later than a ROS 2 message can say"):
        write_log(tmp_path / "a.mcap", frames=frames)


@pytest.mark.parametrize(("what", "name"), [("depth", "depth image"), ("labels", "label image")])
def test_an_image_of_another_size_is_refused(tmp_path: Path, what: str, name: str) -> None:
    source = SmallSource(with_labels=True)
    frames = with_frame(source, 3, **{what: np.zeros((25, 32), np.uint16)})
    message = f"^frame 3: the {name} is 32x25, the camera 32x24; "
    with pytest.raises(ProgroundError, match=message):
        write_log(tmp_path / "a.mcap", source, frames=frames)
    assert not (tmp_path / "a.mcap").exists()


def test_a_log_that_was_not_finished_never_takes_its_name(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    def forgetful() -> None:
        origin = Origin("small data", "small", {})
        with open_writer(path, SmallSource().calibration, origin, {}, None) as writer:
            writer.write(SmallSource().frame(0))

    with pytest.raises(RuntimeError, match="was not finished"):
        forgetful()
    assert not (tmp_path / "a.mcap").exists()


def test_label_names_are_plain_json(tmp_path: Path) -> None:
    reader = LogReader(write_log(tmp_path / "a.mcap", SmallSource(1, with_labels=True)))
    names = json.loads(reader.attachment(topics.LABEL_NAMES_ATTACHMENT) or b"")
    assert names == {str(label): name for label, name in LABEL_NAMES.items()}


@pytest.mark.parametrize(
    "distortion",
    [(0.1, -0.02, 0.01, -0.004), (0.0, 0.0, 0.0, 0.0), (0.2, -0.9, 0.0, 0.01, 1.1, 0.3, -0.7, 0.9)],
)
def test_every_lens_comes_back(tmp_path: Path, distortion: tuple[float, ...]) -> None:
    rig = Calibration.registered(replace(CAMERA, distortion=distortion))
    reader = LogReader(write_log(tmp_path / "a.mcap", SmallSource(1, rig)))
    assert reader.calibration == rig


def test_a_frame_keeps_cameras_and_things_of_its_own(tmp_path: Path) -> None:
    source = SmallSource(4, RIG, with_labels=True)
    refocused = replace(RIG, color=replace(COLOR, fx=39.0), depth=replace(CAMERA, cx=15.5))
    instances = np.arange(30 * 40, dtype=np.uint16).reshape(30, 40)
    frames = with_frame(source, 2, calibration=refocused, instances=instances)
    first, _, third, fourth = LogReader(
        write_log(tmp_path / "a.mcap", frames=frames, source=source)
    ).frames()
    assert first.calibration is None
    assert fourth.calibration is None
    assert third.calibration is not None
    assert (third.calibration.color, third.calibration.depth) == (refocused.color, refocused.depth)
    assert first.instances is None
    np.testing.assert_array_equal(third.instances, instances)


def test_what_is_known_from_the_start_stands_before_the_frames(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", SmallSource(1, with_labels=True))
    with path.open("rb") as stream:
        names = [type(record).__name__ for record in StreamReader(stream, emit_chunks=True).records]
    assert names.index("Metadata") < names.index("Attachment") < names.index("Chunk")
