"""No damage is read as data: the reader refuses it, `check` names it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.well_known import MessageEncoding
from mcap.writer import Writer

from proground_log.errors import ProgroundError
from proground_log.log import topics
from proground_log.log.checking.check import check_log
from proground_log.log.reader import LogReader
from proground_log.log.writer import register_schema, start_mcap
from tests.log.rewriting import rewrite
from tests.writers.small_source import SmallSource, write_log


def everything(path: Path) -> list[object]:
    """All that a reader can give of a log."""
    reader = LogReader(path)
    rig = reader.calibration
    return [
        reader.recording,
        reader.label_names,
        reader.attachment(topics.MESH_ATTACHMENT),
        (rig.color, rig.depth, rig.depth_from_color.tobytes()),
        *(
            (
                (frame.index, frame.stamp_ns, frame.color_stamp_ns, frame.color_format),
                (bytes(frame.color), frame.depth.dtype, frame.depth.tobytes()),
                (frame.world_from_camera.tobytes(), frame.labels.tobytes()),
            )
            for frame in reader.frames()
            if frame.labels is not None
        ),
    ]


def faults(path: Path) -> list[str]:
    """What `check` says; the error's text where it cannot open the log."""
    try:
        return [fault.what for fault in check_log(path, lambda *_: None)]
    except ProgroundError as error:
        return [str(error)]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    return write_log(path, SmallSource(2, with_labels=True))


@pytest.fixture(scope="module")
def content(log: Path) -> list[object]:
    assert faults(log) == []
    return everything(log)


# Positions are parts of the file; those close to 1 lie in metadata, attachments and index.
positions = st.one_of(st.floats(0.0, 1.0), st.floats(0.7, 1.0), st.floats(0.0, 0.01))


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(position=positions, bit=st.integers(0, 7))
@example(position=0.0, bit=0)
@example(position=1.0, bit=7)
def test_a_flipped_bit_is_noticed(
    position: float, bit: int, log: Path, content: list[object], tmp_path: Path
) -> None:
    data = bytearray(log.read_bytes())
    data[round(position * (len(data) - 1))] ^= 1 << bit
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(data)
    assert faults(damaged)
    with suppress(ProgroundError):
        assert everything(damaged) == content


@pytest.mark.parametrize("bit", range(8 * 13))
def test_a_flipped_bit_in_the_end_of_the_data_is_noticed(
    bit: int, log: Path, tmp_path: Path
) -> None:
    data = bytearray(log.read_bytes())
    at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    data[at + bit // 8] ^= 1 << bit % 8
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(data)
    assert faults(damaged)


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(position=st.floats(0.0, 1.0, exclude_max=True))
@example(position=0.0)
def test_a_log_that_was_cut_off_is_refused(position: float, log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    cut = tmp_path / "b.mcap"
    cut.write_bytes(data[: int(position * len(data))])
    with pytest.raises(ProgroundError, match=r"b\.mcap: (is no MCAP file|the file is cut off); "):
        LogReader(cut)


@pytest.mark.parametrize("text", [b"[-3.0, -3.0", b"bounds_lower_m", b"kept", b"small data"])
def test_damaged_metadata_is_refused(text: bytes, log: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(log.read_bytes().replace(text, b"7" + text[1:]))
    with pytest.raises(ProgroundError, match=r"b\.mcap: its metadata is damaged"):
        LogReader(damaged)


def test_a_missing_checksum_is_noticed(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")  # The record that ends the data.
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(data[:at] + b"\x2f" + data[at + 1 :])
    assert faults(damaged) == ["has no checksum over the whole file"]


def test_a_damaged_mesh_is_refused(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes().replace(b"not looked into", b"not looked onto")
    damaged = tmp_path / "b.mcap"
    damaged.write_bytes(data)
    reader = LogReader(damaged)
    message = r"b\.mcap: the file is damaged \(the checksum of the attachment ground_truth_mesh"
    with pytest.raises(ProgroundError, match=message):
        reader.attachment(topics.MESH_ATTACHMENT)
    assert faults(damaged) == ["the checksum over the whole file does not hold"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: {**m, "schema_version": "2"}, "schema version 2, this pglog reads 1; record it"),
        (lambda m: {k: v for k, v in m.items() if k != "schema_version"}, "schema version None"),
        (lambda m: {**m, "frames": "7"}, "its metadata is damaged"),
        (lambda m: {k: v for k, v in m.items() if k not in ("crc32", "notes")}, "metadata is dam"),
    ],
)
def test_metadata_of_others_is_refused(
    change: Callable[[dict[str, str]], dict[str, str]], message: str, log: Path, tmp_path: Path
) -> None:
    path = rewrite(log, tmp_path / "b.mcap", metadata=change)
    with pytest.raises(ProgroundError, match=rf"b\.mcap: .*{message}"):
        LogReader(path)


def test_an_mcap_file_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("a", "jsonschema", b"{}")
        channel = writer.register_channel("/a", "json", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=b"{}")
        writer.finish()
    with pytest.raises(ProgroundError, match=r"is an MCAP file, but not a log of pglog; make one"):
        LogReader(path)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"time,x\n1,2\n" * 50])
def test_what_is_no_mcap_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    path.write_bytes(content)
    with pytest.raises(ProgroundError, match=r"b\.mcap: (is no MCAP file|the file is cut off); "):
        LogReader(path)


def message_order(path: Path, order: list[int], target: Path) -> Path:
    """The log's frames, a chunk each, in another order in the file, or some more than once."""
    groups = list(LogReader(path).groups())
    with path.open("rb") as stream, target.open("wb") as output:
        reader, writer = make_reader(stream), start_mcap(output)
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for schema, channel, message in (item for number in order for item in groups[number]):
            assert schema is not None
            if channel.topic not in channels:
                if schema.name not in schemas:
                    schemas[schema.name] = register_schema(writer, schema.name)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, "cdr", schemas[schema.name]
                )
            time_ns = message.log_time
            number = channels[channel.topic]
            writer.add_message(number, time_ns, message.data, time_ns, message.sequence)
            if channel.topic == topics.LABELS_PREVIEW:
                writer.flush()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for kept in reader.iter_attachments():
            writer.add_attachment(0, 0, kept.name, kept.media_type, kept.data)
        writer.finish()
    return target


@pytest.fixture(scope="module")
def longer_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("longer") / "a.mcap"
    return write_log(path, SmallSource(6, with_labels=True))


@pytest.mark.parametrize(
    ("order", "expected"),
    [
        ([0, 1, 2, 3, 4, 5], []),
        ([0, 1, 3, 4, 5], [("2", "is missing")]),
        ([0, 3, 4, 5], [("1 to 2", "are missing")]),
        ([0, 1, 2, 3], [("", "4 frames found, 6 announced")]),
        ([1, 2, 3, 4, 5], [("0", "is missing")]),
        ([0, 1, 2, 3, 4, 5, 2], [("2", "comes again")]),
    ],
)
def test_frames_that_are_missing_or_come_again_are_named(
    order: list[int], expected: list[tuple[str, str]], longer_log: Path, tmp_path: Path
) -> None:
    path = message_order(longer_log, order, tmp_path / "b.mcap")
    found = [(fault.frame, fault.what) for fault in check_log(path, lambda *_: None)]
    # Where the cameras sit is lost with the first frame.
    assert [item for item in found if "has no /tf_static" not in item[1]] == expected


def test_a_frame_that_stands_twice_in_a_row_is_named(longer_log: Path, tmp_path: Path) -> None:
    path = message_order(longer_log, [0, 1, 2, 2, 3, 4, 5], tmp_path / "b.mcap")
    found = check_log(path, lambda *_: None)
    assert {fault.frame for fault in found} == {"2"}
    assert {fault.what for fault in found} == {"the message comes again"}
    assert topics.DEPTH in {fault.topic for fault in found}


def test_chunks_that_are_not_in_order_are_named(longer_log: Path, tmp_path: Path) -> None:
    path = message_order(longer_log, [0, 1, 4, 2, 3, 5], tmp_path / "b.mcap")
    assert [frame.index for frame in LogReader(path).frames()] == list(range(6))
    found = check_log(path, lambda *_: None)
    assert [fault.frame for fault in found] == ["2", "3"]
    assert all(fault.what.startswith("time does not increase after") for fault in found)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"name": "std_msgs/msg/String"}, "its messages are of type 'std_msgs/msg/String', not"),
        ({"data": b"uint8[] data\n"}, "its schema is not the definition of 'sensor_msgs/msg/Im"),
        ({"encoding": "ros2idl"}, "its schema is not the definition of 'sensor_msgs/msg/Image'"),
    ],
)
def test_a_wrong_schema_is_named(
    change: dict[str, str | bytes], what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register = Writer.register_schema

    def changed(writer: Writer, name: str, encoding: str, data: bytes) -> int:
        given = {"name": name, "encoding": encoding, "data": data}
        if name == "sensor_msgs/msg/Image":
            given |= change
        return register(writer, **given)

    monkeypatch.setattr(Writer, "register_schema", changed)
    path = write_log(tmp_path / "b.mcap", SmallSource(2))
    [fault] = faults(path)
    assert fault.startswith(f"{path}, {topics.DEPTH}: {what}")


def test_a_wrong_encoding_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(MessageEncoding, "CDR", "json")
        path = write_log(tmp_path / "b.mcap", SmallSource(2))
    [fault] = faults(path)
    assert "its messages are encoded as 'json', not 'cdr'" in fault


def test_damage_is_followed_by_what_to_do(longer_log: Path, tmp_path: Path) -> None:
    path = message_order(longer_log, [0, 1, 2, 3, 4, 5], tmp_path / "b.mcap")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    assert any("`pglog recover` saves the rest" in what for what in faults(path))
    path.write_bytes(data[:-1])
    assert "save its whole frames with `pglog recover`" in faults(path)[0]
    partial = path.rename(tmp_path / "b.mcap.partial")
    assert "the recording was stopped before its end" in faults(partial)[0]
