"""Perceiving: a log becomes a log with regions, frame by frame, and goes on where it stopped."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from proground_log.files import require_free, written_whole
from proground_log.frame import SensorFrame
from proground_log.log import messages, topics
from proground_log.log.reader import FrameDecoder, LogReader
from proground_log.log.region_message import decode_regions, encode_regions
from proground_log.log.regions_writer import RegionsWriter
from proground_log.log.task_record import TaskRecord
from proground_log.perception.description import ATTACHMENT
from proground_log.perception.journal import open_journal
from proground_log.perception.perceiver import Perceiver
from proground_log.perception.preview import draw_preview
from proground_log.perception.summary import PerceivedSummary, Tally
from proground_log.perception.task import Task
from proground_log.regions import Regions


def perceive(
    log: Path,
    perceiver: Perceiver,
    output: Path,
    *,
    overwrite: bool,
    progress: Callable[[int, int], None],
) -> PerceivedSummary:
    """Copy a log and add what a perceiver finds in each frame.

    All else is copied byte for byte; what an earlier perceiver added is replaced. Regions are kept
    in a journal beside the output as they are found, so that after an interruption a call with the
    same log and perceiver goes on, and ends in the same bytes.

    Args:
        log: the log.
        perceiver: finds the regions.
        output: the log with regions; takes its name once it is whole.
        overwrite: replace an output that is there.
        progress: told the frames done and the frames in all.

    Returns:
        What was found.
    """
    require_free(output, overwrite=overwrite)
    reader, description = LogReader(log), perceiver.description
    task, attachment = description.task, description.to_bytes()
    tally = Tally(task, reader.label_names)
    encode_preview = messages.encoder(messages.COMPRESSED_IMAGE_TYPE)
    decode = FrameDecoder(reader.calibration, where=log)
    with (
        open_journal(journal_path(output), _key(log, attachment)) as journal,
        written_whole(output) as temporary,
        temporary.open("wb") as stream,
    ):
        writer = RegionsWriter(stream, reader)
        progress(0, len(reader))
        for index, group in enumerate(reader.groups()):
            others = [item for item in group if item[1].topic not in topics.PERCEPTION]
            sensor = decode(index, others)
            if index == len(journal):
                journal.append(encode_regions(perceiver(sensor), sensor.color_stamp_ns))
            # Read back also when they are new, so that an interruption cannot make a difference.
            encoded = journal[index]
            regions = decode_regions(encoded, where=f"{output}, frame {index}, {topics.REGIONS}")
            tally.add(regions, sensor.labels)
            writer.write(others, encoded, encode_preview(_preview(sensor, regions, task)))
            progress(index + 1, len(reader))
        summary = tally.summary()
        record = TaskRecord(task.name, task.sha256, task.all_prompts, summary.regions)
        writer.finish(record, ATTACHMENT, attachment)
    return summary


def journal_path(output: Path) -> Path:
    """Where the regions of an output that is not yet whole are kept."""
    return output.with_name(output.name + ".regions.partial")


def _key(log: Path, attachment: bytes) -> bytes:
    """What the regions depend on, in 32 bytes."""
    with log.open("rb") as stream:
        content = hashlib.file_digest(stream, "sha256").digest()
    return hashlib.sha256(content + attachment).digest()


def _preview(sensor: SensorFrame, regions: Regions, task: Task) -> object:
    picture = draw_preview(sensor.decode_color(), regions, task)
    return messages.compressed_image(picture, "jpeg", sensor.color_stamp_ns, topics.COLOR_FRAME)
