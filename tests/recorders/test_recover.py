"""Recovery saves every whole frame of a damaged log, and nothing that was not in it."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from pglog.recover import recover_command
from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.log import topics, writer
from proground_log.log.checking.check import check_log
from proground_log.log.reader import LogReader
from recorders.recover import SUFFIX, Recovery, recover
from tests.regions import write_perceived_log
from tests.writers.small_source import CAMERA, LABEL_NAMES, MESH, SmallSource, with_frame, write_log

pytestmark = pytest.mark.slow

COUNT = 8
Frames = dict[int, dict[str, bytes]]


def quiet(_done: int, _total: int) -> None: ...


def rescue(log: Path, name: str = "saved.mcap") -> tuple[Recovery, Path]:
    """Recover a log; what comes out has no fault, and the log is as it was."""
    before, output = log.read_bytes(), log.with_name(name)
    recovery = recover(log, output, overwrite=True, progress=quiet)
    assert log.read_bytes() == before
    assert check_log(output, quiet) == []
    return recovery, output


def raw_frames(path: Path) -> Frames:
    """The bytes of each frame's messages, by time and topic, but for where the cameras sit."""
    return {
        group[0][2].log_time: {
            channel.topic: message.data
            for _, channel, message in group
            if channel.topic != topics.TF_STATIC
        }
        for group in LogReader(path).groups()
    }


def chunks(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)


def frames_by_chunk(path: Path) -> list[set[int]]:
    """The times of the frames that have messages in each chunk, by the index."""
    times: list[set[int]] = []
    for chunk in chunks(path):
        data = path.read_bytes()[chunk.chunk_start_offset :][: chunk.chunk_length]
        content = zstandard.decompress(data[-chunk.compressed_size :])
        found, offset = set(), 0
        while offset < len(content):
            opcode, length = struct.unpack_from("<BQ", content, offset)
            if opcode == 5:
                found.add(struct.unpack_from("<Q", content, offset + 15)[0])
            offset += 9 + length
        times.append(found)
    return times


def record_starts(data: bytes) -> list[int]:
    """Where each record of a whole log begins, and where its last magic does."""
    starts, offset = [], 8
    while offset < len(data) - 8:
        starts.append(offset)
        offset += 9 + struct.unpack_from("<Q", data, offset + 1)[0]
    return [*starts, offset]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log whose frames lie across the borders of chunks."""
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "CHUNK_BYTES", 9000)
        write_log(path, SmallSource(COUNT, with_labels=True))
    assert len(chunks(path)) > 3
    assert any(a & b for a, b in pairwise(frames_by_chunk(path)))
    return path


@pytest.fixture(scope="module")
def whole(log: Path) -> Frames:
    return raw_frames(log)


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    return tmp_path / "b.mcap"


def test_a_healthy_log_comes_out_as_it_was(log: Path, whole: Frames, damaged: Path) -> None:
    damaged.write_bytes(log.read_bytes())
    recovery, saved = rescue(damaged)
    assert recovery == Recovery(COUNT, 0, 0, (), {})
    assert str(recovery) == "8 frames; nothing was damaged"
    assert raw_frames(saved) == whole
    first, second = LogReader(log), LogReader(saved)
    assert second.calibration == first.calibration
    assert second.label_names == LABEL_NAMES
    assert second.attachment(topics.MESH_ATTACHMENT) == MESH
    assert second.recording == replace(
        first.recording,
        bounds=second.recording.bounds,
        notes={"kept": "all", "recovered": "8 frames; nothing was damaged"},
    )
    for name in (topics.COLOR, topics.LABELS_PREVIEW):
        assert name in {channel.topic for channel in second.channels.values()}


def test_recovering_twice_gives_the_same_bytes(log: Path, damaged: Path) -> None:
    damaged.write_bytes(log.read_bytes()[:-1])
    contents = [rescue(damaged, name)[1].read_bytes() for name in ("c.mcap", "d.mcap")]
    assert contents[0] == contents[1]


def cuts() -> list[float]:
    return np.random.default_rng(5).uniform(0, 1, 20).tolist()


@pytest.mark.parametrize("how", ["between", "in a head", "in a content", "before the end", "any"])
def test_a_log_that_is_cut_anywhere(how: str, log: Path, whole: Frames, damaged: Path) -> None:
    data = log.read_bytes()
    starts = record_starts(data)
    ends = [*starts[1:], len(data)]
    positions = {
        "between": starts,
        "in a head": [start + 5 for start in starts[:-1]],
        "in a content": [(start + end) // 2 for start, end in zip(starts, ends, strict=True)],
        "before the end": [end - 1 for end in ends],
        "any": [int(share * len(data)) for share in cuts()],
    }[how]
    last_chunk = chunks(log)[-1]
    for cut in positions:
        damaged.write_bytes(data[:cut])
        here = [chunk.chunk_start_offset + chunk.chunk_length <= cut for chunk in chunks(log)]
        lost = set[int]().union(
            *(
                times
                for times, is_here in zip(frames_by_chunk(log), here, strict=True)
                if not is_here
            )
        )
        expected = {time_ns: raw for time_ns, raw in whole.items() if time_ns not in lost}
        with pytest.raises(ProgroundError, match=r"b\.mcap: the file is cut off; .*pglog recover"):
            LogReader(damaged)
        if not expected:
            with pytest.raises(ProgroundError, match=r"b\.mcap: nothing can be saved: no frame"):
                rescue(damaged)
            assert list(damaged.parent.iterdir()) == [damaged]
            continue
        recovery, saved = rescue(damaged)
        assert raw_frames(saved) == expected
        assert recovery.frames == len(expected)
        assert recovery.damage == ("the end of the file",)
        assert LogReader(saved).attachment(topics.MESH_ATTACHMENT) == MESH
        if cut < last_chunk.chunk_start_offset:
            assert recovery.lost == max(0, recovery.incomplete)
        saved.unlink()


@pytest.mark.parametrize("size", [0, 1, 8, 20])
def test_what_holds_nothing_gives_nothing(size: int, log: Path, damaged: Path) -> None:
    damaged.write_bytes(log.read_bytes()[:size])
    with pytest.raises(ProgroundError, match=r"b\.mcap: nothing can be saved: no frame of a log"):
        rescue(damaged)
    assert list(damaged.parent.iterdir()) == [damaged]


def test_flipped_bits_lose_no_more_than_their_chunk(
    log: Path, whole: Frames, damaged: Path
) -> None:
    data, rng = log.read_bytes(), np.random.default_rng(7)
    spans = [
        (chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length)
        for chunk in chunks(log)
    ]
    times = frames_by_chunk(log)
    heads = [start + offset for start, _ in spans for offset in (0, 1, 2, 8, 30, 40, 47)]
    anywhere = rng.integers(0, len(data), 60).tolist()
    for position in [*heads, *anywhere, 0, len(data) - 1]:
        flipped = bytearray(data)
        flipped[position] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(flipped)
        hit = [number for number, (a, b) in enumerate(spans) if a <= position < b]
        lost = times[hit[0]] if hit else set()
        recovery, saved = rescue(damaged)
        found = raw_frames(saved)
        assert found.items() <= whole.items()
        assert whole.keys() - found.keys() <= lost, position
        assert recovery.damage, position
        assert recovery.lost == COUNT - len(found)
        assert LogReader(saved).calibration == LogReader(log).calibration
        for name, content in ((topics.MESH_ATTACHMENT, MESH),):
            assert LogReader(saved).attachment(name) in (content, None)
        assert LogReader(saved).label_names in (LABEL_NAMES, {})


def test_any_bytes_give_an_error_or_true_frames(log: Path, whole: Frames, damaged: Path) -> None:
    data, rng = log.read_bytes(), np.random.default_rng(11)
    outcomes = []
    for _ in range(80):
        changed = bytearray(data)
        for _ in range(int(rng.integers(1, 12))):
            start, length = int(rng.integers(len(changed))), int(rng.integers(1, 40))
            kind = rng.integers(4)
            if kind == 0:
                del changed[start : start + length]
            elif kind == 1:
                changed[start : start + length] = rng.bytes(length)
            elif kind == 2:
                changed[start:start] = changed[int(rng.integers(len(changed))) :][:length]
            else:
                changed[start] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(changed)
        try:
            found = raw_frames(rescue(damaged)[1])
        except ProgroundError as error:
            outcomes.append(0 if error.where == str(damaged) else -1)
        else:
            assert found.items() <= whole.items()
            outcomes.append(len(found))
    assert min(outcomes) == 0 < max(outcomes)


def moved(log: Path, order: list[int]) -> bytes:
    """The log with its chunks in another order, or some more than once."""
    data, pieces = log.read_bytes(), chunks(log)
    spans = [
        data[chunk.chunk_start_offset :][: chunk.chunk_length + chunk.message_index_length]
        for chunk in pieces
    ]
    start = pieces[0].chunk_start_offset
    end = start + sum(map(len, spans))
    return data[:start] + b"".join(spans[number] for number in order) + data[end:]


def test_chunks_in_any_order_come_into_order(log: Path, whole: Frames, damaged: Path) -> None:
    last = len(chunks(log)) - 1
    damaged.write_bytes(moved(log, [0, *range(last, 0, -1), 2]))
    _, saved = rescue(damaged)
    assert raw_frames(saved) == whole
    assert list(raw_frames(saved)) == list(whole)


def test_a_chunk_that_was_cut_out_takes_only_its_frames(
    log: Path, whole: Frames, damaged: Path
) -> None:
    times, numbers = frames_by_chunk(log), list(range(len(chunks(log))))
    damaged.write_bytes(moved(log, numbers[:2] + numbers[3:]))
    recovery, saved = rescue(damaged)
    assert whole.keys() - raw_frames(saved).keys() == times[2]
    assert recovery.lost == len(times[2])
    assert recovery.incomplete >= 1


def test_labels_that_only_some_frames_have_are_not_asked_of_all(damaged: Path) -> None:
    source = SmallSource(COUNT, with_labels=True)
    frames = with_frame(source, 3, labels=None)
    write_log(damaged, source, frames=frames)
    recovery, saved = rescue(damaged)
    assert recovery.frames == COUNT
    assert [frame.labels is None for frame in LogReader(saved).frames()].index(True) == 3


def test_a_frame_without_its_labels_is_not_whole(
    damaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A chunk for each message; the labels of frame 4 and what follows are cut off.
    monkeypatch.setattr(writer, "CHUNK_BYTES", 1)
    write_log(damaged, SmallSource(COUNT, with_labels=True))
    times, spans = frames_by_chunk(damaged), chunks(damaged)
    fourth = sorted(set().union(*times))[4]
    start = [times[n] == {fourth} for n in range(len(spans))].index(True)
    after_depth = spans[start + 5].chunk_start_offset
    damaged.write_bytes(damaged.read_bytes()[:after_depth])
    recovery, saved = rescue(damaged)
    assert (recovery.frames, recovery.lost, recovery.incomplete) == (4, 1, 1)
    assert str(recovery) == "4 frames; 1 damaged place, 1 frame lost, 1 of them incomplete"
    assert LogReader(saved).recording.notes["recovered"] == str(recovery)


RIG = Calibration(replace(CAMERA, fx=35.0), CAMERA, np.eye(4))


def without_first_chunk(log: Path, damaged: Path) -> None:
    data = bytearray(log.read_bytes())
    data[chunks(log)[0].chunk_start_offset + 60] ^= 1
    damaged.write_bytes(data)


def test_where_one_camera_sits_is_known(log: Path, damaged: Path) -> None:
    without_first_chunk(log, damaged)
    recovery, saved = rescue(damaged)
    assert recovery.notes == {"cameras": "assumed to be one; where they sit is lost"}
    assert LogReader(saved).calibration.is_registered
    assert LogReader(saved).recording.notes["cameras"] == recovery.notes["cameras"]


def test_where_two_cameras_sit_is_not_guessed(damaged: Path) -> None:
    path = write_log(damaged.with_name("a.mcap"), SmallSource(40, RIG))
    without_first_chunk(path, damaged)
    message = r"b\.mcap: nothing can be saved: where its two cameras sit stood in a frame"
    with pytest.raises(ProgroundError, match=message):
        rescue(damaged)


def test_where_two_cameras_sit_is_kept_of_an_incomplete_frame(
    damaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", 1)
    mount = np.eye(4)
    mount[0, 3] = 0.05
    rig = replace(RIG, depth_from_color=mount)
    write_log(damaged, SmallSource(5, rig))
    data = bytearray(damaged.read_bytes())
    data[chunks(damaged)[3].chunk_start_offset + 60] ^= 1
    damaged.write_bytes(data)
    recovery, saved = rescue(damaged)
    assert (recovery.frames, recovery.lost, recovery.incomplete) == (4, 1, 1)
    assert LogReader(saved).calibration == rig


def test_frames_keep_cameras_of_their_own(damaged: Path) -> None:
    source = SmallSource(COUNT, RIG)
    own = replace(RIG, depth=replace(CAMERA, fx=31.0))
    write_log(damaged, source, frames=with_frame(source, 2, calibration=own))
    _, saved = rescue(damaged)
    assert [frame.calibration for frame in LogReader(saved).frames()].index(own) == 2


def test_without_topics_nothing_can_be_saved(log: Path, damaged: Path) -> None:
    without_first_chunk(log, damaged)
    damaged.write_bytes(damaged.read_bytes()[:-1])
    with pytest.raises(ProgroundError, match="nothing can be saved"):
        rescue(damaged)


def test_a_perceived_log_stays_one(damaged: Path) -> None:
    write_perceived_log(damaged)
    raw = raw_frames(damaged)
    recovery, saved = rescue(damaged)
    assert recovery.notes == {}
    assert raw_frames(saved) == raw
    assert LogReader(saved).task == LogReader(damaged).task


def test_regions_without_their_task_are_left_out(damaged: Path) -> None:
    write_perceived_log(damaged)
    raw = raw_frames(damaged)
    damaged.write_bytes(damaged.read_bytes().replace(b"proground.task", b"proground.tusk", 1))
    recovery, saved = rescue(damaged)
    assert recovery.notes == {"perception": "left out, for what it looked for is lost"}
    assert LogReader(saved).task is None
    assert raw_frames(saved) == {
        time_ns: {topic: data for topic, data in of.items() if topic not in topics.PERCEPTION}
        for time_ns, of in raw.items()
    }


def test_a_recording_that_is_still_called_partial(log: Path, whole: Frames, damaged: Path) -> None:
    partial = damaged.with_name("b.mcap.partial")
    partial.write_bytes(log.read_bytes()[: -len(log.read_bytes()) // 3])
    recovery, saved = rescue(partial, "b.mcap")
    assert raw_frames(saved).items() <= whole.items()
    assert 0 < recovery.frames < COUNT
    assert LogReader(saved).recording.source == "small data"
    assert sorted(damaged.parent.iterdir()) == [saved, partial]


def test_the_log_is_never_the_output(log: Path, damaged: Path) -> None:
    data = log.read_bytes()
    for source, output in (
        (damaged, damaged),
        (damaged.with_name("c.mcap" + SUFFIX), damaged.with_name("c.mcap")),
    ):
        source.write_bytes(data)
        with pytest.raises(ProgroundError, match="the output is the log to recover; choose"):
            recover(source, output, overwrite=True, progress=quiet)
        assert source.read_bytes() == data


def test_an_output_that_exists_is_left_alone(log: Path, damaged: Path) -> None:
    damaged.write_bytes(b"before")
    with pytest.raises(ProgroundError, match=r"b\.mcap: the output exists; "):
        recover(log, damaged, overwrite=False, progress=quiet)
    assert damaged.read_bytes() == b"before"
    with pytest.raises(ProgroundError, match=r"no\.mcap: no such file"):
        recover(log.with_name("no.mcap"), damaged, overwrite=True, progress=quiet)


def test_a_chunk_that_would_fill_the_memory_is_left_out(
    log: Path, whole: Frames, damaged: Path
) -> None:
    data, at = log.read_bytes(), chunks(log)[2].chunk_start_offset
    bomb = zstandard.compress(bytes(2**26)) * 1
    content = struct.pack("<QQQI", 0, 0, 2**40, 1) + b"\x04\0\0\0zstd"
    content += struct.pack("<Q", len(bomb)) + bomb
    damaged.write_bytes(data[:at] + struct.pack("<BQ", 6, len(content)) + content + data[at:])
    recovery, saved = rescue(damaged)
    assert recovery.damage[0] == f"a chunk at byte {at} (its size is wrong)"
    assert raw_frames(saved).items() <= whole.items()


def test_the_command(log: Path, damaged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(log.read_bytes())
    data[chunks(log)[2].chunk_start_offset + 60] ^= 1
    damaged.write_bytes(data)
    output = damaged.with_name("c.mcap")
    assert recover_command(damaged, output=output) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"{output}: ")
    assert "1 damaged place" in printed
    assert "a chunk at byte " in printed
    assert recover_command(damaged, output=output, overwrite=True, as_json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frames"] == len(LogReader(output))
    assert told["frames"] + told["lost"] == COUNT
    assert len(told["damage"]) == 1


def test_a_file_of_false_beginnings_ends(damaged: Path) -> None:
    start = struct.pack("<BQQQQI", 6, 1_000_000, 0, 0, 500, 1) + b"\x04\0\0\0zstd"
    damaged.write_bytes(b"\x89MCAP0\r\n" + start * 50_000)
    with pytest.raises(ProgroundError, match="nothing can be saved"):
        rescue(damaged)
