"""`check` names each fault with its frame and its topic."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from proground_log.errors import ProgroundError
from proground_log.log import topics
from proground_log.log.checking.check import Fault, check_log
from proground_log.log.reader import LogReader
from tests.log.rewriting import Edit, rewrite
from tests.writers.small_source import SmallSource, with_frame, write_log

BAD = 3
"""The frame that is broken."""


def check(path: Path) -> list[Fault]:
    return check_log(path, lambda *_: None)


def at_bad_frame(topic: str, change: Callable[[Any], Any]) -> Edit:
    """An edit of one message of one frame; `change` works in place, or returns another."""

    def edit(its_topic: str, frame: int, message: Any) -> Any:
        if (its_topic, frame) != (topic, BAD):
            return message
        changed = change(message)
        return message if changed is None else changed

    return edit


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("good") / "a.mcap"
    return write_log(path, SmallSource(6, with_labels=True))


@pytest.fixture(scope="module")
def jpeg_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("jpeg") / "a.mcap"
    return write_log(path, SmallSource(6, color_format="jpeg"))


@pytest.mark.parametrize("in_metres", [False, True])
def test_a_good_log_has_no_fault(tmp_path: Path, in_metres: bool) -> None:
    told: list[tuple[int, int]] = []
    path = write_log(tmp_path / "a.mcap", SmallSource(3, in_metres=in_metres, with_labels=True))
    assert check_log(path, lambda done, total: told.append((done, total))) == []
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_a_rewritten_log_has_no_fault(log: Path, tmp_path: Path) -> None:
    assert check(rewrite(log, tmp_path / "b.mcap", chunk_bytes=2000)) == []


def set_rotation(message: Any, factor: float) -> None:
    rotation = message.transforms[0].transform.rotation
    for name in "xyzw":
        setattr(rotation, name, factor * getattr(rotation, name))


def set_position(message: Any, value: float) -> None:
    message.transforms[0].transform.translation.y = value


def cut_data(message: Any, share: float) -> None:
    message.data = bytes(message.data[: int(share * len(message.data))])


def set_width(message: Any) -> None:
    message.width, message.height = message.height, message.width


@pytest.mark.parametrize(
    ("topic", "change", "what"),
    [
        (topics.TF, lambda m: set_position(m, np.nan), "pose has numbers that are not finite"),
        (topics.TF, lambda m: set_position(m, np.inf), "pose has numbers that are not finite"),
        (topics.TF, lambda m: set_rotation(m, np.nan), "pose has numbers that are not finite"),
        (topics.TF, lambda m: set_rotation(m, 1.1), "not rigid"),
        (topics.TF, lambda m: set_rotation(m, 0.0), "not rigid"),
        (topics.TF, lambda m: m.transforms.clear(), "has 0 transforms, not one"),
        (topics.COLOR, lambda m: cut_data(m, 0.7), "the png image is cut short or damaged"),
        (topics.COLOR, lambda m: cut_data(m, 0.0), "the png image is cut short or damaged"),
        (topics.DEPTH, lambda m: cut_data(m, 0.5), "cannot be read"),
        (topics.DEPTH, set_width, "the image is 24x32, the camera 32x24"),
        (topics.LABELS, set_width, "the image is 24x32, the camera 32x24"),
        (topics.DEPTH, lambda m: setattr(m, "encoding", "rgb8"), "encoding 'rgb8'.*cannot be read"),
        (topics.DEPTH, lambda m: setattr(m, "data", bytes(len(m.data))), "has no depth at all"),
        (topics.COLOR, lambda _: b"\x00\x01\x00\x00abc", "the message cannot be decoded"),
        (topics.DEPTH, lambda _: b"", "the message cannot be decoded"),
    ],
)
def test_a_broken_message_is_named(
    topic: str, change: Callable[[Any], Any], what: str, log: Path, tmp_path: Path
) -> None:
    path = rewrite(log, tmp_path / "b.mcap", at_bad_frame(topic, change))
    [fault] = check(path)
    assert (fault.frame, fault.topic) == (str(BAD), topic)
    assert re.search(what, fault.what)


@pytest.mark.parametrize("topic", [topics.TF, topics.COLOR, topics.DEPTH])
def test_a_missing_message_is_named(topic: str, log: Path, tmp_path: Path) -> None:
    def edit(its_topic: str, frame: int, message: Any) -> Any:
        return None if (its_topic, frame) == (topic, BAD) else message

    path = rewrite(log, tmp_path / "b.mcap", edit)
    assert check(path) == [Fault(str(BAD), topic, "the message is missing")]
    with pytest.raises(ProgroundError, match=rf"b\.mcap, frame {BAD}, {topic}: the message is mis"):
        list(LogReader(path).frames())


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_jpeg_that_is_cut_short_is_named(share: float, jpeg_log: Path, tmp_path: Path) -> None:
    edit = at_bad_frame(topics.COLOR, lambda m: cut_data(m, share))
    [fault] = check(rewrite(jpeg_log, tmp_path / "b.mcap", edit))
    assert fault == Fault(str(BAD), topics.COLOR, "the jpeg image is cut short or damaged")


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (np.nan, "has depths that are not finite"),
        (np.inf, "has depths that are not finite"),
        (-1.0, "has negative depths"),
    ],
)
def test_an_impossible_depth_is_named(value: float, what: str, tmp_path: Path) -> None:
    source = SmallSource(5, in_metres=True)
    depth = source.frame(BAD).depth.copy()
    depth[5, 7] = value
    path = write_log(tmp_path / "a.mcap", source, frames=with_frame(source, BAD, depth=depth))
    assert check(path) == [Fault(str(BAD), topics.DEPTH, what)]


def test_depth_outside_the_bounds_is_named(tmp_path: Path) -> None:
    source = SmallSource(5)
    pose = np.eye(4)
    pose[0, 3] = 5.0
    frames = with_frame(source, BAD, world_from_camera=pose)
    [fault] = check(write_log(tmp_path / "a.mcap", source, frames=frames))
    assert (fault.frame, fault.topic) == (str(BAD), topics.DEPTH)
    assert fault.what == "only 0% of its depth lies inside the log's bounds"


def test_time_that_runs_back_is_named(log: Path, tmp_path: Path) -> None:
    first_ns = SmallSource().frame(0).stamp_ns

    def time_ns(frame: int, time_ns: int) -> int:
        return first_ns + 5 if frame == BAD else time_ns

    path = rewrite(log, tmp_path / "b.mcap", log_time_ns=time_ns)
    [fault] = check(path)
    assert (fault.frame, fault.topic) == (str(BAD), "")
    assert fault.what.startswith("time does not increase after ")


@pytest.mark.parametrize("announced", [4, 6])
def test_a_wrong_number_of_frames_is_named(announced: int, tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", announced=announced)
    assert check(path) == [Fault("", "", f"5 frames found, {announced} announced")]


def test_every_fault_is_named(log: Path, tmp_path: Path) -> None:
    def edit(topic: str, frame: int, message: Any) -> Any:
        if (topic, frame) == (topics.TF, 1):
            set_position(message, np.nan)
        if (topic, frame) == (topics.COLOR, 4):
            cut_data(message, 0.5)
        return message

    found = check(rewrite(log, tmp_path / "b.mcap", edit))
    assert [(fault.frame, fault.topic) for fault in found] == [
        ("1", topics.TF),
        ("4", topics.COLOR),
    ]


def chunk_offsets(path: Path) -> list[tuple[int, int]]:
    """Where the data of each chunk begins, and how long they are."""
    data = path.read_bytes()
    with path.open("rb") as stream:
        records = StreamReader(stream, emit_chunks=True).records
        chunks = [record for record in records if isinstance(record, Chunk)]
    return [(data.index(chunk.data), len(chunk.data)) for chunk in chunks]


@pytest.mark.parametrize(("number", "name"), [(0, "first"), (1, "after"), (-1, "after")])
def test_a_damaged_chunk_is_named(number: int, name: str, log: Path, tmp_path: Path) -> None:
    path = rewrite(log, tmp_path / "b.mcap", chunk_bytes=3000)
    assert len(chunk_offsets(path)) > 2
    start, length = chunk_offsets(path)[number]
    data = bytearray(path.read_bytes())
    data[start + length // 2] ^= 0x10
    path.write_bytes(data)
    found = check(path)
    damaged = [fault for fault in found if "a chunk, " in fault.what]
    assert len(damaged) == 1
    assert damaged[0].frame.startswith(name)
    assert " s to " in damaged[0].what
    with pytest.raises(ProgroundError, match=r"b\.mcap: the file is damaged"):
        list(LogReader(path).frames())
