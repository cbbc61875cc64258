"""Recording and reading the kitchen against what OpenCV and mcap alone need."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from mcap.reader import make_reader

from benchmarks.rows import SHARED_DATA, Row, median_seconds
from proground_log.frame import Selection
from proground_log.log import topics
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from recorders.record import record
from recorders.registry import open_source

KITCHEN = SHARED_DATA / "7scenes_redkitchen" / "seq-01"
FRAMES = 250


def measure() -> list[Row]:
    """Ratios of recording and reading."""
    if not KITCHEN.is_dir():
        return []
    with tempfile.TemporaryDirectory() as folder:
        return _measure(Path(folder, "kitchen.mcap"))


def _measure(log: Path) -> list[Row]:
    depth_files = sorted(KITCHEN.glob("*.depth.png"))[:FRAMES]

    def record_log(jobs: int | None = None) -> None:
        source = open_source("seven-scenes", KITCHEN)
        record(
            source,
            "kitchen",
            log,
            Selection(stop=FRAMES),
            overwrite=True,
            progress=lambda *_: None,
            jobs=jobs,
        )

    def decode_depth() -> None:
        for path in depth_files:
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED)

    record_s, depth_s = median_seconds(record_log, decode_depth, rounds=5)
    one_job_s, two_jobs_s = median_seconds(partial(record_log, 1), partial(record_log, 2), rounds=5)
    reader = LogReader(log)
    register = Registration(reader.calibration)

    def read_log() -> None:
        for frame in reader.frames():
            frame.decode_color()

    def read_and_register() -> None:
        for frame in reader.frames():
            register(frame)

    def mcap_and_opencv() -> None:
        with log.open("rb") as stream:
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                if channel.topic == topics.COLOR:
                    jpeg = message.data[message.data.find(b"\xff\xd8") :]
                    cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)

    read_s, register_s, alone_s = median_seconds(
        read_log, read_and_register, mcap_and_opencv, rounds=5
    )
    per_frame = 1e3 / FRAMES
    return [
        Row("recording the kitchen, a frame", per_frame * record_s, "ms"),
        Row("OpenCV decoding its depth, a frame", per_frame * depth_s, "ms"),
        Row("recording / OpenCV decoding the depth", record_s / depth_s, "x", most=1.7),
        Row("recording with one job / with two", one_job_s / two_jobs_s, "x", least=1.6),
        Row("reading the kitchen back, a frame", per_frame * read_s, "ms"),
        Row("mcap and OpenCV alone, a frame", per_frame * alone_s, "ms"),
        Row("reading / mcap and OpenCV alone", read_s / alone_s, "x", most=1.5),
        Row("reading and registering, a frame", per_frame * register_s, "ms"),
    ]
