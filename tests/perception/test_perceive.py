"""Perceiving: regions come in, everything else stays as it was, and no interruption shows."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader

from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.log import topics
from proground_log.log.checking.check import check_log
from proground_log.log.reader import LogReader
from proground_log.perception.description import ATTACHMENT
from proground_log.perception.journal import open_journal
from proground_log.perception.of_log import perception_of, task_of_labels
from proground_log.perception.perceive import journal_path, perceive
from proground_log.perception.preview import draw_preview
from proground_log.perception.summary import PerceivedSummary
from proground_log.regions import Regions
from tests.full_disk import largest_file
from tests.regions import TASK, LabelPerceiver, description
from tests.writers.small_source import SmallSource, write_log

FRAMES = 8


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plain") / "a.mcap"
    return write_log(path, SmallSource(FRAMES, with_labels=True))


@pytest.fixture(scope="module")
def one_go(log: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The log with regions, made without an interruption."""
    path = tmp_path_factory.mktemp("one-go") / "a.mcap"
    run(log, path)
    return path.read_bytes()


def run(
    log: Path,
    output: Path,
    perceiver: LabelPerceiver | None = None,
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> PerceivedSummary:
    perceiver = perceiver or LabelPerceiver()
    return perceive(log, perceiver, output, overwrite=overwrite, progress=progress)


@dataclass
class StoppedPerceiver(LabelPerceiver):
    """Is interrupted when it comes to one frame."""

    at: int = 0
    error: type[BaseException] = KeyboardInterrupt

    def __call__(self, frame: SensorFrame) -> Regions:
        if frame.index == self.at:
            raise self.error
        return super().__call__(frame)


# What is in the new log.


def test_everything_else_is_copied_byte_for_byte(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "b.mcap"
    output.write_bytes(one_go)
    assert [raw for raw in messages(output) if raw[0] not in topics.PERCEPTION] == messages(log)
    before, after = LogReader(log), LogReader(output)
    added = {topics.TASK_METADATA}
    assert {k: v for k, v in after.metadata.items() if k not in added} == before.metadata
    assert set(after.metadata) - set(before.metadata) == added
    names = [index.name for index in before.attachments]
    assert [index.name for index in after.attachments] == [*names, ATTACHMENT]
    for old, new in zip(before.attachments, after.attachments, strict=False):
        assert (old.create_time, old.log_time) == (new.create_time, new.log_time)
        assert old.media_type == new.media_type
        assert before.attachment(old.name) == after.attachment(new.name)
    assert after.recording == before.recording
    assert after.label_names == before.label_names
    assert check_log(output, lambda *_: None) == []


def messages(path: Path) -> list[tuple[object, ...]]:
    """All that belongs to each message, in the order of the file."""
    with path.open("rb") as stream:
        return [
            (
                *(channel.topic, schema.name, schema.data, channel.metadata),
                *(message.log_time, message.publish_time, message.sequence, message.data),
            )
            for schema, channel, message in NonSeekingReader(stream, True).iter_messages(
                log_time_order=False
            )
            if schema is not None
        ]


def test_regions_stand_at_the_time_of_their_frame(one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "b.mcap"
    output.write_bytes(one_go)
    keys = [(raw[4], raw[6]) for raw in messages(output)]
    source = SmallSource(FRAMES)
    assert keys == sorted(keys)
    for topic in topics.PERCEPTION:
        found = [raw[4:7] for raw in messages(output) if raw[0] == topic]
        times = [source.frame(index).stamp_ns for index in range(FRAMES)]
        assert found == [(time_ns, time_ns, i) for i, time_ns in enumerate(times)]


def test_the_perception_comes_back(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "b.mcap"
    output.write_bytes(one_go)
    found = perception_of(LogReader(output))
    assert found is not None
    assert found.to_bytes() == description().to_bytes()
    assert perception_of(LogReader(log)) is None


def test_another_perception_takes_the_place_of_the_first(
    log: Path, one_go: bytes, tmp_path: Path
) -> None:
    first, second, direct = (tmp_path / name for name in ("1.mcap", "2.mcap", "3.mcap"))
    first.write_bytes(one_go)
    other = LabelPerceiver(replace(description(1), task=replace(TASK, name="other")))
    run(first, second, other)
    run(log, direct, LabelPerceiver(other.description))
    assert second.read_bytes() == direct.read_bytes() != one_go
    found = perception_of(LogReader(second))
    assert found is not None
    assert found.task.name == "other"
    # In place, too.
    run(first, first, overwrite=True)
    assert first.read_bytes() == one_go


def test_a_task_and_a_perception_that_disagree_are_refused(one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "b.mcap"
    output.write_bytes(one_go)
    reader = LogReader(output)
    assert reader.task is not None
    reader.task = replace(reader.task, name="tools", sha256="0" * 64)
    message = "names one task and has the perception of another .'tools' and 'things'.; run"
    with pytest.raises(ProgroundError, match=message):
        perception_of(reader)
    reader.task = None
    with pytest.raises(ProgroundError, match="has regions, but its task is missing"):
        perception_of(reader)
    reader = LogReader(output)
    reader.attachments = []
    with pytest.raises(ProgroundError, match="has regions, but its perception is missing"):
        perception_of(reader)


def test_the_summary_counts(log: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    perceiver = LabelPerceiver()
    output = tmp_path / "a.mcap"
    summary = run(log, output, perceiver, progress=lambda *done: told.append(done))
    assert told == [(done, FRAMES) for done in range(FRAMES + 1)]
    assert perceiver.seen == list(range(FRAMES))
    assert (summary.frames, summary.regions) == (FRAMES, 3 * (FRAMES - 1))
    assert summary.by_prompt == {"chair": 7, "küche": 7, "lamp": 7}
    labels = np.stack([SmallSource(1, with_labels=True).frame(i).labels for i in range(FRAMES)])
    is_seen = (np.arange(FRAMES) != 1)[:, None, None]
    assert summary.covered == pytest.approx(((labels > 0) & is_seen).mean())
    # All of the true classes are prompts, "Küche" in another spelling; one frame was not seen.
    assert summary.right == pytest.approx(((labels > 0) & is_seen).sum() / (labels > 0).sum())
    reader = LogReader(output)
    assert reader.task is not None
    assert reader.task.regions == summary.regions


def test_without_true_classes_nothing_is_right_or_wrong(tmp_path: Path) -> None:
    @dataclass
    class Nothing(LabelPerceiver):
        def __call__(self, frame: SensorFrame) -> Regions:
            return super().__call__(replace(frame, index=1, labels=np.zeros((24, 32), np.uint16)))

    log = write_log(tmp_path / "a.mcap", SmallSource(3))
    assert run(log, tmp_path / "b.mcap", Nothing()) == PerceivedSummary(
        3, 0, 0.0, dict.fromkeys(TASK.all_prompts, 0), None
    )


def test_the_task_of_a_log_names_its_classes(log: Path, tmp_path: Path) -> None:
    reader = LogReader(log)
    task = task_of_labels(reader, lambda _: True)
    assert (task.name, task.prompts) == ("everything", ("chair", "küche", "lamp"))
    assert task_of_labels(reader, lambda name: name != "küche").prompts == ("chair", "lamp")
    plain = LogReader(write_log(tmp_path / "a.mcap"))
    with pytest.raises(ProgroundError, match="has no ground-truth classes to make a task of"):
        task_of_labels(plain, lambda _: True)


# The picture.


def test_the_preview_is_tinted_in_the_colours_of_the_task() -> None:
    palette = TASK.prompt_colors()
    assert palette[2].tolist() == [255, 128, 0]
    assert len(np.unique(palette, axis=0)) == 3
    color = np.full((60, 220, 3), 100, np.uint8)
    owner = np.zeros((60, 220), np.uint16)
    owner[20:50, :100], owner[20:50, 120:] = 1, 2
    regions = Regions(
        boxes=np.array([[0, 20, 100, 50], [120, 20, 220, 50]], np.float32),
        levels=np.zeros(2, np.uint8),
        relevance=np.array([[0.0, 0.1, 0.9], [0.2, 0.1, 0.0]], np.float32),
        embeddings=np.zeros((2, 512), np.float16),
        owner=owner,
        is_box=np.zeros(2, bool),
    )
    jpeg = np.frombuffer(draw_preview(color, regions, TASK), np.uint8)
    picture = cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB).astype(int)
    assert np.abs(picture[:15] - 100).max() < 12
    strong, faint = picture[40:48, 5:95].mean((0, 1)), picture[40:48, 130:215].mean((0, 1))
    assert np.abs(strong - (0.445 * 100 + 0.555 * palette[2])).max() < 8
    assert np.abs(faint - (0.76 * 100 + 0.24 * palette[0])).max() < 8
    # What the mapper learns from has box and text as well.
    assert np.abs(picture[49, 5:95] - palette[2]).mean() < 60
    assert picture[20:40, :100].min() < 40 < picture[20:50, 120:].min()


# Interruptions.


@pytest.mark.parametrize("at", range(FRAMES))
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interruption_does_not_show(
    at: int, error: type[BaseException], log: Path, one_go: bytes, tmp_path: Path
) -> None:
    output = tmp_path / "a.mcap"
    with pytest.raises(error):
        run(log, output, StoppedPerceiver(at=at, error=error))
    assert list(tmp_path.iterdir()) == [journal_path(output)] * (at > 0)
    perceiver = LabelPerceiver()
    run(log, output, perceiver)
    assert perceiver.seen == list(range(at, FRAMES))
    assert output.read_bytes() == one_go
    assert list(tmp_path.iterdir()) == [output]


def test_several_interruptions_do_not_show(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "a.mcap"
    for at in (3, 3, 4, 7):
        with pytest.raises(KeyboardInterrupt):
            run(log, output, StoppedPerceiver(at=at))
    run(log, output)
    assert output.read_bytes() == one_go


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0, 1), tail=st.binary(max_size=40), flip=st.booleans())
def test_a_torn_journal_does_not_show(
    share: float,
    tail: bytes,
    flip: bool,
    log: Path,
    one_go: bytes,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    output = tmp_path_factory.mktemp("torn") / "a.mcap"
    with pytest.raises(KeyboardInterrupt):
        run(log, output, StoppedPerceiver(at=5))
    journal = journal_path(output)
    data = bytearray(journal.read_bytes())
    at = int(share * len(data))
    if flip and at < len(data):
        data[at] ^= 0x04
    else:
        data = data[:at] + tail
    journal.write_bytes(data)
    perceiver = LabelPerceiver()
    run(log, output, perceiver)
    assert output.read_bytes() == one_go
    # No frame is done again for nothing: only those behind the damage.
    assert perceiver.seen == list(range(FRAMES - len(perceiver.seen), FRAMES))
    assert share < 0.999 or len(perceiver.seen) <= 4
    assert not journal.exists()


def test_the_journal_of_other_work_is_not_taken(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "a.mcap"
    other_log = write_log(tmp_path / "o.mcap", SmallSource(FRAMES, with_labels=True, notes={}))
    for other, perceiver in (
        (log, StoppedPerceiver(description(1), at=5)),
        (other_log, StoppedPerceiver(at=5)),
    ):
        with pytest.raises(KeyboardInterrupt):
            run(other, output, perceiver)
        assert perceiver.seen == [0, 1, 2, 3, 4]
    again = LabelPerceiver()
    run(log, output, again)
    assert again.seen == list(range(FRAMES))
    assert output.read_bytes() == one_go


def test_a_killed_process_does_not_show(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "a.mcap"
    program = textwrap.dedent(f"""
        import time
        from pathlib import Path
        from proground_log.perception.perceive import perceive
        from tests.regions import LabelPerceiver

        class Slow(LabelPerceiver):
            def __call__(self, frame):
                time.sleep(0.05)
                return super().__call__(frame)

        perceive(Path({str(log)!r}), Slow(), Path({str(output)!r}), overwrite=False,
                 progress=lambda *_: None)
    """)
    journal = journal_path(output)
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        deadline = time.monotonic() + 60
        # Three frames of some 3 kB each.
        while time.monotonic() < deadline and process.poll() is None:
            if journal.exists() and journal.stat().st_size > 10_000:
                break
            time.sleep(0.005)
        os.kill(process.pid, signal.SIGKILL)
    assert not output.exists()
    perceiver = LabelPerceiver()
    run(log, output, perceiver)
    assert 0 < len(perceiver.seen) < FRAMES
    assert output.read_bytes() == one_go
    assert list(tmp_path.iterdir()) == [output]


def test_a_full_disk_is_named_and_does_not_show(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "a.mcap"
    with largest_file(15_000), pytest.raises(ProgroundError, match=r"cannot write: .*; "):
        run(log, output)
    assert not output.exists()
    run(log, output)
    assert output.read_bytes() == one_go
    assert list(tmp_path.iterdir()) == [output]


def test_records_of_any_length_come_back(tmp_path: Path) -> None:
    path, records = tmp_path / "journal", [b"", b"a" * 100_000, b"\0" * 12, b""]
    with suppress(KeyboardInterrupt), open_journal(path, b"k" * 32) as journal:
        for record in records:
            journal.append(record)
            assert journal[len(journal) - 1] == record
        raise KeyboardInterrupt
    with open_journal(path, b"k" * 32) as journal:
        assert [journal[number] for number in range(len(journal))] == records
    assert not path.exists()


# What is refused.


def test_an_output_that_exists_is_refused_before_any_work(log: Path, tmp_path: Path) -> None:
    output, perceiver = tmp_path / "a.mcap", LabelPerceiver()
    output.write_text("precious")
    with pytest.raises(ProgroundError, match="the output exists"):
        run(log, output, perceiver)
    assert (perceiver.seen, output.read_text()) == ([], "precious")
    assert list(tmp_path.iterdir()) == [output]
    run(log, output, perceiver, overwrite=True)
    assert len(LogReader(output)) == FRAMES


@pytest.mark.parametrize(("announced", "message"), [(9, "frame 8 is missing"), (7, "has 8 frames")])
def test_a_log_with_another_number_of_frames_is_refused(
    announced: int, message: str, tmp_path: Path
) -> None:
    source = SmallSource(FRAMES, with_labels=True)
    log = write_log(tmp_path / "a.mcap", source, announced=announced)
    with pytest.raises(ProgroundError, match=f"{message}, the log announces {announced}"):
        run(log, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_the_new_log_is_written_like_any_other(log: Path, one_go: bytes, tmp_path: Path) -> None:
    output = tmp_path / "b.mcap"
    output.write_bytes(one_go)
    for path in (log, output):
        with path.open("rb") as stream:
            header = make_reader(stream).get_header()
            assert (header.profile, header.library) == ("ros2", "proground-log")
