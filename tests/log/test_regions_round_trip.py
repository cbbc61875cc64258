"""Regions go into a log and come out of it; nothing broken is read as regions."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import AT_EDGE
from proground_log.log import topics
from proground_log.log.checking.check import Fault, check_log
from proground_log.log.info import log_info
from proground_log.log.reader import LogReader
from proground_log.log.region_message import decode_regions, encode_regions
from proground_log.log.registration import JUMP_M, JUMP_SHARE, Registration
from proground_log.log.task_record import TaskRecord
from proground_log.regions import EMBEDDING_WIDTH, Regions
from tests.log.rewriting import rewrite
from tests.regions import TASK, LabelPerceiver, write_perceived_log
from tests.writers.small_source import CAMERA, SmallSource, write_log

BAD = 3
"""The frame that is broken."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_perceived_log(tmp_path_factory.mktemp("good") / "a.mcap")


def assert_equal(found: Regions, expected: Regions) -> None:
    for part in fields(Regions):
        a, b = getattr(found, part.name), getattr(expected, part.name)
        assert (a.dtype, a.shape) == (b.dtype, b.shape), part.name
        np.testing.assert_array_equal(a, b)


def check(path: Path) -> list[Fault]:
    return check_log(path, lambda *_: None)


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(0, 40),
    prompts=st.integers(1, 7),
    size=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_regions_come_back(count: int, prompts: int, size: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2**16, (count, EMBEDDING_WIDTH), dtype=np.uint16)
    regions = Regions(
        boxes=rng.normal(0, 1e3, (count, 4)).astype(np.float32),
        levels=rng.integers(0, 3, count, dtype=np.uint8),
        relevance=rng.random((count, prompts), dtype=np.float32),
        embeddings=bits.view(np.float16),
        owner=rng.integers(0, count + 1, size, dtype=np.uint16),
        is_box=rng.random(count) < 0.5,
    )
    encoded = encode_regions(regions, seed)
    found = decode_regions(encoded, where="here")
    np.testing.assert_array_equal(found.embeddings.view(np.uint16), bits)
    assert_equal(replace(found, embeddings=regions.embeddings), regions)
    assert encode_regions(found, seed)[4:] == encoded[4:]


def test_regions_come_back_with_their_frames(log: Path) -> None:
    perceiver, source = LabelPerceiver(), SmallSource(6, with_labels=True)
    frames = list(LogReader(log).frames())
    assert len(frames) == 6
    for index, frame in enumerate(frames):
        assert frame.regions is not None
        assert_equal(frame.regions, perceiver(source.frame(index)))
    assert [len(frame.regions or ()) for frame in frames[:2]] == [3, 0]


def test_the_log_says_what_was_found(log: Path) -> None:
    expected = TaskRecord("things", TASK.sha256, ("chair", "küche", "lamp"), 15)
    assert LogReader(log).task == log_info(log).task == expected
    assert log_info(log).messages[topics.REGIONS] == 6
    assert log_info(log).messages[topics.REGIONS_PREVIEW] == 6


def test_a_log_without_regions_has_none(tmp_path: Path) -> None:
    reader = LogReader(write_log(tmp_path / "a.mcap", SmallSource(2)))
    sensor = next(reader.frames())
    frame = Registration(reader.calibration)(sensor)
    assert (reader.task, sensor.regions, frame.regions, frame.region_of) == (None,) * 4


def test_other_programs_see_columns_and_a_picture(log: Path) -> None:
    found: dict[str, Any] = {}
    with log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, _, decoded in reader.iter_decoded_messages():
            assert schema is not None
            found.setdefault(channel.topic, (schema.name, decoded))
    name, message = found[topics.REGIONS]
    source = SmallSource(6, with_labels=True)
    regions, frame = LabelPerceiver()(source.frame(0)), source.frame(0)
    assert name == "proground_msgs/msg/Regions"
    assert list(message.boxes) == regions.boxes.ravel().tolist()
    assert (message.prompts, len(message.relevance)) == (3, 9)
    stamp = message.header.stamp
    assert stamp.sec * 1_000_000_000 + stamp.nanosec == frame.color_stamp_ns
    assert message.header.frame_id == topics.COLOR_FRAME
    owner = cv2.imdecode(np.frombuffer(message.owner, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(owner, regions.owner)
    name, preview = found[topics.REGIONS_PREVIEW]
    assert (name, preview.format) == ("sensor_msgs/msg/CompressedImage", "jpeg")
    picture = cv2.imdecode(np.frombuffer(preview.data, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (CAMERA.height, CAMERA.width, 3)


# Registration.


def frame_with(depth: np.ndarray, owner: np.ndarray, calibration: Calibration) -> Any:
    count = int(owner.max())
    regions = Regions(
        boxes=np.zeros((count, 4), np.float32),
        levels=np.zeros(count, np.uint8),
        relevance=np.ones((count, 1), np.float32),
        embeddings=np.zeros((count, EMBEDDING_WIDTH), np.float16),
        owner=owner,
        is_box=np.zeros(count, bool),
    )
    sensor = replace(
        SmallSource(calibration=calibration).frame(0), depth=depth, labels=owner, regions=regions
    )
    return Registration(calibration)(sensor)


@pytest.mark.parametrize("seed", range(4))
def test_regions_are_cut_at_depth_jumps_and_holes(seed: int) -> None:
    """Against a slow cut, pixel by pixel."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:24, :32]
    depth_m = np.where(columns > rng.integers(8, 24), 1.0, 2.5) + 0.02 * rng.random((24, 32))
    depth_m[rows > 18] += 0.001 * (columns[rows > 18] ** 2)
    depth_m[rng.random((24, 32)) < 0.02] = 0
    depth = (depth_m * 1000).astype(np.uint16)
    owner = rng.integers(0, 5, (24, 32), dtype=np.uint16)
    frame = frame_with(depth, owner, Calibration.registered(CAMERA))
    expected = owner.astype(np.int32) - 1
    z = frame.depth_m
    for row, column in np.ndindex(24, 32):
        around = z[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        jump = np.abs(around - z[row, column]) > JUMP_SHARE * z[row, column] + JUMP_M
        if jump.any() or not around.all():
            expected[row, column] = AT_EDGE
    assert frame.region_of.dtype == np.int32
    np.testing.assert_array_equal(frame.region_of, expected)
    assert 0.1 < (expected >= 0).mean() < 0.8


def test_a_slanted_wall_is_not_cut() -> None:
    """A wall seen at 15 degrees, its depth in whole millimetres."""
    columns = CAMERA.directions[..., 0]
    depth = np.rint(1000 / (1 - columns / np.tan(np.radians(15)) * 0.2)).astype(np.uint16)
    owner = np.ones((24, 32), np.uint16)
    frame = frame_with(depth, owner, Calibration.registered(CAMERA))
    assert depth.max() > 1.8 * depth.min()
    assert (frame.region_of == 0).all()


@pytest.mark.parametrize("lens", [(), (0.12, -0.2, 0.003, -0.002, 0.05)])
@pytest.mark.parametrize("baseline_m", [0.0, 0.1])
def test_regions_are_looked_up_as_labels_are(lens: tuple[float, ...], baseline_m: float) -> None:
    depth_from_color = np.eye(4)
    depth_from_color[0, 3] = baseline_m
    calibration = Calibration(
        Camera(48, 40, 40.0, 41.0, 24.5, 19.0, lens), CAMERA, depth_from_color
    )
    depth = np.full((24, 32), 1500, np.uint16)
    depth[4:6, 4:6] = 0
    owner = np.random.default_rng(0).integers(0, 9, (40, 48), dtype=np.uint16)
    frame = frame_with(depth, owner, calibration)
    flat = cv2.erode(depth, np.ones((3, 3), np.uint8)) > 0
    # In the same way where there is no jump; the labels of this frame are the owners.
    np.testing.assert_array_equal(frame.region_of[flat], frame.labels[flat].astype(int) - 1)
    assert (frame.region_of[~flat] == AT_EDGE).all()
    assert len(np.unique(frame.region_of)) == 10


# Faults.


def array(change: Callable[[np.ndarray], Any], name: str, dtype: str) -> Callable[[Any], None]:
    """A change of one array of a message."""

    def edit(message: Any) -> None:
        value = getattr(message, name)
        is_bytes = isinstance(value, bytes)
        values = np.frombuffer(value, dtype).copy() if is_bytes else np.array(value, dtype)
        change(values)
        setattr(message, name, values.tobytes() if is_bytes else values.tolist())

    return edit


def put(at: int, value: float) -> Callable[[np.ndarray], None]:
    def change(values: np.ndarray) -> None:
        values[at] = value

    return change


def cut(name: str) -> Callable[[Any], None]:
    def edit(message: Any) -> None:
        setattr(message, name, getattr(message, name)[:-1])

    return edit


def another_owner(dtype: type[np.generic], value: int) -> Callable[[Any], None]:
    def edit(message: Any) -> None:
        _, png = cv2.imencode(".png", np.full((24, 32), value, dtype))
        message.owner = png.tobytes()

    return edit


def grow(message: Any) -> None:
    message.height, message.width = 25, 33
    _, png = cv2.imencode(".png", np.zeros((25, 33), np.uint16))
    message.owner = png.tobytes()


READABLE = [
    (array(put(0, np.nan), "boxes", "f4"), "a box that is not finite or not inside .* 32x24"),
    (array(put(2, np.inf), "boxes", "f4"), "a box that is not finite or not inside"),
    (array(put(0, -0.5), "boxes", "f4"), "a box that is not finite or not inside"),
    (array(put(3, 24.5), "boxes", "f4"), "a box that is not finite or not inside"),
    (array(put(0, 32.5), "boxes", "f4"), "a box that is not finite or not inside"),
    (array(put(4, 1.01), "relevance", "f4"), "a relevance that is not from 0 to 1"),
    (array(put(4, -0.01), "relevance", "f4"), "a relevance that is not from 0 to 1"),
    (array(put(4, np.nan), "relevance", "f4"), "a relevance that is not from 0 to 1"),
    (array(put(700, np.inf), "embeddings", "f2"), "an embedding that is not finite"),
    (grow, "the image is 33x25, the camera 32x24"),
]
UNREADABLE = [
    (array(put(1, 3), "levels", "u1"), "a region has the level 3, there are 3"),
    (cut("boxes"), "3 regions and 3 prompts have 11 values of boxes, not 12"),
    (cut("levels"), "2 regions and 3 prompts have 12 values of boxes, not 8"),
    (cut("relevance"), "8 values of relevance, not 9"),
    (lambda m: setattr(m, "prompts", 4), "9 values of relevance, not 12"),
    (cut("embeddings"), "3071 values of embeddings, not 3072"),
    (cut("is_box"), "2 values of is_box, not 3"),
    (cut("owner"), "its image of owners is no whole 16-bit PNG"),
    (lambda m: setattr(m, "owner", b""), "its image of owners is no whole 16-bit PNG"),
    (another_owner(np.uint8, 0), "its image of owners is no whole 16-bit PNG"),
    (another_owner(np.uint16, 4), "a pixel belongs to region 3, there are 3"),
    (lambda m: setattr(m, "width", 31), "its image of owners is 32x24, not 31x24"),
]


def broken(log: Path, path: Path, change: Callable[[Any], Any]) -> Path:
    def edit(topic: str, frame: int, message: Any) -> Any:
        if (topic, frame) == (topics.REGIONS, BAD):
            return change(message) or message
        return message

    return rewrite(log, path, edit)


def test_a_good_log_has_no_fault(log: Path, tmp_path: Path) -> None:
    assert check(log) == []
    assert check(rewrite(log, tmp_path / "b.mcap")) == []


@pytest.mark.parametrize(("change", "what"), READABLE + UNREADABLE)
def test_broken_regions_are_named(
    change: Callable[[Any], None], what: str, log: Path, tmp_path: Path
) -> None:
    [fault] = check(broken(log, tmp_path / "b.mcap", change))
    assert (fault.frame, fault.topic) == (str(BAD), topics.REGIONS)
    assert re.search(what, fault.what)


@pytest.mark.parametrize(("change", "what"), UNREADABLE)
def test_regions_that_do_not_fit_together_are_refused(
    change: Callable[[Any], None], what: str, log: Path, tmp_path: Path
) -> None:
    path = broken(log, tmp_path / "b.mcap", change)
    message = rf"b\.mcap, frame {BAD}, /perception/regions: .*{what}; run `pglog perceive` again"
    with pytest.raises(ProgroundError, match=message):
        list(LogReader(path).frames())


def test_bytes_that_are_no_regions_are_refused(log: Path, tmp_path: Path) -> None:
    path = broken(log, tmp_path / "b.mcap", lambda _: b"\x00\x01\x00\x00abc")
    [fault] = check(path)
    assert (fault.topic, fault.what) == (topics.REGIONS, "the message cannot be decoded")
    with pytest.raises(ProgroundError, match=r"^here: the message cannot be decoded; run"):
        decode_regions(b"\x00\x01\x00\x00abc", where="here")


def test_missing_regions_are_named(log: Path, tmp_path: Path) -> None:
    def edit(topic: str, frame: int, message: Any) -> Any:
        return None if (topic, frame) == (topics.REGIONS, BAD) else message

    found = check(rewrite(log, tmp_path / "b.mcap", edit))
    assert found == [Fault(str(BAD), topics.REGIONS, "the message is missing")]


def test_a_task_that_does_not_fit_is_named(log: Path, tmp_path: Path) -> None:
    def shorter(metadata: dict[str, str]) -> dict[str, str]:
        if "prompts" not in metadata:
            return metadata
        return TaskRecord("things", TASK.sha256, ("chair",), 15).to_metadata()

    found = check(rewrite(log, tmp_path / "b.mcap", metadata=shorter))
    what = "has relevance to 3 prompts, the task has 1"
    assert found == [Fault(str(frame), topics.REGIONS, what) for frame in range(6)]


@pytest.mark.parametrize(
    "change",
    [
        lambda m: {**m, "regions": "7"},
        lambda m: {**m, "prompts": '["chair"]'},
        lambda m: {key: text for key, text in m.items() if key != "crc32"},
    ],
)
def test_a_damaged_task_is_refused(
    change: Callable[[dict[str, str]], dict[str, str]], log: Path, tmp_path: Path
) -> None:
    def metadata(content: dict[str, str]) -> dict[str, str]:
        return change(content) if "prompts" in content else content

    path = rewrite(log, tmp_path / "b.mcap", metadata=metadata)
    with pytest.raises(ProgroundError, match=r"b\.mcap: what it says about its task is damaged"):
        LogReader(path)
