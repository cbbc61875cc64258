"""`pglog record`: what it writes and prints, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.frame import Selection, SensorFrame
from proground_log.log.reader import LogReader
from recorders.formats.seven_scenes import SevenScenesSource
from recorders.record import record
from recorders.room import RoomSource
from tests.commands import Pglog, assert_one_clear_line
from tests.full_disk import largest_file
from tests.writers.small_source import SmallSource


@pytest.fixture
def kitchen(shared_data: Path, tmp_path: Path) -> Path:
    """Four frames of a real sequence, to be spoiled."""
    folder = tmp_path / "kitchen"
    folder.mkdir()
    for path in sorted((shared_data / "7scenes_redkitchen" / "seq-01").iterdir())[:12]:
        shutil.copyfile(path, folder / path.name)
    return folder


def test_record_seven_scenes(pglog: Pglog, shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "7scenes_redkitchen" / "seq-01"
    log = tmp_path / "a.mcap"
    selection = ["--start", 2, "--stop", 9, "--stride", 3]
    answer = pglog("record", "seven-scenes", source, "-o", log, *selection)
    assert answer.code == 0
    assert re.fullmatch(
        rf"{re.escape(str(log))}: 3 frames, \d\.\d MB\n"
        r"  frames without a pose: 0\n  agreement: 99% .*\n",
        answer.out,
    )
    assert "3/3" in answer.err
    reader = LogReader(log)
    opened = SevenScenesSource(source)
    for frame, index in zip(reader.frames(), (2, 5, 8), strict=True):
        expected = opened.frame(index)
        assert frame.color == expected.color
        np.testing.assert_array_equal(frame.depth, expected.depth)
        assert frame.stamp_ns == expected.stamp_ns
        difference = np.abs(frame.world_from_camera - expected.world_from_camera).max()
        assert difference < 1e-4  # The text files' rotations are not quite rotations.
    assert reader.recording.source == "seq-01"
    elsewhere = tmp_path / "elsewhere" / "b.mcap"
    assert pglog("record", "seven-scenes", source, "-o", elsewhere, *selection).code == 0
    assert elsewhere.read_bytes() == log.read_bytes()
    check_and_info(pglog, log, frames=3, labels=0, registered=False)


def test_record_tum(pglog: Pglog, shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "tum_fr1_rpy_sample" / "rgbd_dataset_freiburg1_rpy"
    log = tmp_path / "a.mcap"
    answer = pglog("record", "tum", source, "-o", log, "--stop", 3, "--stride", 2)
    assert answer.code == 0
    assert "2 frames" in answer.out
    assert "pairs without a pose: " in answer.out
    check_and_info(pglog, log, frames=2, labels=0, registered=True)


def test_record_replica(pglog: Pglog, shared_data: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    source = shared_data / "aws_small_house_labelled"
    answer = pglog("record", "replica", source, "-o", log, "--start", 100, "--stop", 102)
    assert answer.code == 0
    reader = LogReader(log)
    assert (
        reader.attachment("ground_truth_mesh.ply")
        == (source / "mesh_semantic_observed.ply").read_bytes()
    )
    assert next(reader.frames()).labels is not None
    check_and_info(pglog, log, frames=2, labels=len(reader.label_names), registered=True)


def test_record_synthetic(pglog: Pglog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The light takes seconds to compute; here it is the same everywhere.
    monkeypatch.setattr(
        "recorders.room.source.bake", lambda _, grid: np.full((len(grid.body), 3), 0.5)
    )
    logs = [tmp_path / name for name in ("a.mcap", "b.mcap", "c.mcap")]
    options = ["--frames", 6, "--stop", 4, "--stride", 3]
    for log, seed in zip(logs, (3, 3, 4), strict=True):
        answer = pglog("record", "synthetic", "-o", log, *options, "--seed", seed, "--noise")
        assert answer.code == 0
        assert f"seed: {seed}" in answer.out
    first, again, other = (log.read_bytes() for log in logs)
    assert first == again != other
    labels = len(RoomSource(frames=1).label_names)
    check_and_info(pglog, logs[0], frames=2, labels=labels, registered=True)


def check_and_info(pglog: Pglog, log: Path, *, frames: int, labels: int, registered: bool) -> None:
    checked = pglog("check", log)
    assert (checked.code, checked.out) == (0, f"{log}: no fault found\n")
    assert f"{frames}/{frames}" in checked.err
    assert json.loads(pglog("check", log, "--json").out) == []
    table = pglog("info", log)
    assert (table.code, table.err) == (0, "")
    for row in (f"{frames} in ", "colour camera", "bounds", "/camera/depth/image", "MB"):
        assert row in table.out
    assert ("the same" in table.out) == registered
    answer = pglog("info", log, "--json")
    assert (answer.code, answer.err) == (0, "")
    info = json.loads(answer.out)
    assert info["frames"] == frames == info["messages"]["/camera/color/image"]
    assert (len(info["labels"]), info["registered"]) == (labels, registered)
    assert info["has_mesh"] == bool(labels)
    assert info["size_bytes"] == log.stat().st_size
    sizes = np.subtract(info["bounds_upper_m"], info["bounds_lower_m"])
    assert (sizes > 0.5).all()


def test_a_calibration_file_overrides_the_cameras(
    pglog: Pglog, kitchen: Path, tmp_path: Path
) -> None:
    camera = {"width": 640, "height": 480, "fx": 500, "fy": 501, "cx": 320, "cy": 240}
    file = tmp_path / "rig.json"
    file.write_text(json.dumps({"depth": camera}))
    log = tmp_path / "a.mcap"
    command = ["record", "seven-scenes", kitchen, "-o", log, "--calibration", file]
    assert pglog(*command).code == 0
    expected = Camera.from_integer_centres(640, 480, 500.0, 501.0, 320.0, 240.0)
    calibration = LogReader(log).calibration
    assert calibration.depth == expected
    assert calibration.is_registered


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": "wide"}, "could not convert"),
        ({"fx": -1}, "a focal length not above 0"),
        ({"cx": float("nan")}, "not finite"),
        ({"width": 0}, "a size of 0x480"),
        ({"distortion": [0.1]}, "1 numbers of distortion, not k1 k2 p1 p2 k3"),
    ],
)
def test_a_broken_calibration_file_is_named(
    pglog: Pglog, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    camera = {"width": 640, "height": 480, "fx": 500, "fy": 501, "cx": 320, "cy": 240}
    file = tmp_path / "rig.json"
    file.write_text(json.dumps({"depth": camera | change}))
    answer = pglog("record", "tum", tmp_path, "-o", tmp_path / "a.mcap", "--calibration", file)
    assert_one_clear_line(answer, f"{file}: is not a calibration", message, "write it like")


@dataclass
class RepeatingSource(SmallSource):
    """A cheap source of any length: one large frame again and again."""

    def __post_init__(self) -> None:
        self._only = super().frame(0)

    def frame(self, index: int) -> SensorFrame:
        return replace(self._only, index=index, stamp_ns=index * 1_000_000)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_frames(tmp_path: Path) -> None:
    camera = Calibration.registered(Camera(320, 240, 300.0, 300.0, 160.0, 120.0))

    def peak_bytes(work: Callable[[], object]) -> int:
        tracemalloc.start()
        try:
            work()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def write(count: int) -> None:
        source = RepeatingSource(count, camera)
        path = tmp_path / f"{count}.mcap"
        record(source, "a", path, Selection(), overwrite=False, progress=lambda *_: None)

    def read(count: int) -> None:
        for frame in LogReader(tmp_path / f"{count}.mcap").frames():
            assert frame.depth.any()

    for work in (write, read):
        few, many = (peak_bytes(lambda: work(count)) for count in (30, 300))  # noqa: B023
        assert many < 1.15 * few + 200_000


def test_an_unknown_format(pglog: Pglog, tmp_path: Path) -> None:
    answer = pglog("record", "seven_scenes", tmp_path, "-o", tmp_path / "a.mcap")
    assert_one_clear_line(answer, "`pglog record seven_scenes`", "the nearest are seven-scenes")


@pytest.mark.parametrize("arguments", [["tum"], ["synthetic", "folder"], ["scannet", "x"]])
def test_a_source_and_words_are_what_a_format_takes(
    pglog: Pglog, tmp_path: Path, arguments: list[str]
) -> None:
    given = ["--label-set", "coco"] if "x" in arguments else []
    answer = pglog("record", *arguments, *given, "-o", tmp_path / "a.mcap")
    assert (answer.code, answer.out) == (2, "")
    assert f"pglog record {arguments[0]} --help" in answer.err
    assert any(part in answer.err for part in ("SOURCE", "folder", "'scannet-to-nyu40'"))


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["tum", "no-such-folder"], ["no-such-folder: no such folder or file; check the path"]),
        (
            ["synthetic", "--max-time-difference-s", "1"],
            [
                "--max-time-difference-s is of tum, redwood, ros2-bag and ros1-bag; "
                "use `pglog record"
            ],
        ),
        (
            ["auto", "bag", "--color-topic", "/rgb"],
            ["record auto: --color-topic is of ros2-bag and ros1-bag; use `pglog record ros2-bag"],
        ),
        (["tum", "x", "--max-time-diference-s", "1"], ["did you mean --max-time-difference-s?"]),
        (["synthetic", "--seed", "-1"], ["the seed is -1"]),
        (["synthetic", "--frames", "0"], ["0 frames are asked for"]),
        (["synthetic", "--start", "5", "--stop", "3"], ["start 5, stop 3, stride 1 select no"]),
        (["synthetic", "--stride", "0"], ["stride of 1 or more"]),
        (["synthetic", "--start", "120"], ["a recording of 120 frames"]),
        (["auto", "x", "--calibration", "no.json"], ["x: no such folder or file"]),
        (["tum", "x", "--calibration", "no.json"], ["no.json: no such file"]),
        (["synthetic", "--calibration", "no.json"], ["there is no option --calibration"]),
    ],
)
def test_wrong_options_of_record(
    pglog: Pglog, tmp_path: Path, arguments: list[str], parts: list[str]
) -> None:
    assert_one_clear_line(pglog("record", *arguments, "-o", tmp_path / "a.mcap"), *parts)
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_exists(pglog: Pglog, kitchen: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_text("precious")
    command = ["record", "seven-scenes", kitchen, "-o", log]
    assert_one_clear_line(pglog(*command), "a.mcap: the output exists; ", "--overwrite")
    assert log.read_text() == "precious"
    assert pglog(*command, "--overwrite").code == 0
    assert len(LogReader(log)) == 4
    answer = pglog("record", "seven-scenes", kitchen, "-o", tmp_path, "--overwrite")
    assert_one_clear_line(answer, f"{tmp_path}: the output is a folder; name a file in it")
    answer = pglog("record", "seven-scenes", kitchen, "-o", log / "b.mcap")
    assert_one_clear_line(answer, "b.mcap: cannot write: ")
    assert_one_clear_line(pglog("replay", log, "-o", log), "a.mcap: is a file; name a folder")


def spoil_depth(folder: Path) -> Path:
    path = sorted(folder.glob("*.depth.png"))[2]
    path.write_bytes(path.read_bytes()[:-2000])
    return path


def spoil_color(folder: Path) -> Path:
    path = sorted(folder.glob("*.color.*"))[2]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def spoil_pose(folder: Path) -> Path:
    path = sorted(folder.glob("*.pose.txt"))[2]
    path.write_text("2 " + path.read_text().split(maxsplit=1)[1])
    return path


def resize_depth(folder: Path) -> Path:
    path = sorted(folder.glob("*.depth.png"))[2]
    cv2.imwrite(str(path), np.ones((240, 320), np.uint16))
    return path


def remove_color(folder: Path) -> Path:
    path = sorted(folder.glob("*.color.*"))[2]
    path.unlink()
    return path.with_suffix("")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_depth, "whole PNG image"),
        (spoil_color, "is cut short"),
        (spoil_pose, "not rigid"),
        (resize_depth, "is 320x240, but the calibration is for 640x480"),
        (remove_color, "is missing"),
    ],
)
def test_a_broken_source(
    pglog: Pglog, kitchen: Path, tmp_path: Path, spoil: Callable[[Path], Path], message: str
) -> None:
    at_fault = spoil(kitchen)
    answer = pglog("record", "seven-scenes", kitchen, "-o", tmp_path / "a.mcap")
    assert answer.code == 2
    assert answer.out == ""
    last = answer.err.splitlines()[-1]
    assert last.startswith(f"pglog: {at_fault}")
    assert message in last
    assert "; " in last
    assert "Traceback" not in answer.err
    assert not (tmp_path / "a.mcap").exists()


def test_a_disk_that_fills_up(pglog: Pglog, kitchen: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    with largest_file(100_000):
        answer = pglog("record", "seven-scenes", kitchen, "-o", log)
    assert answer.code == 2
    last = answer.err.splitlines()[-1]
    assert re.fullmatch(
        rf"pglog: {re.escape(str(log))}: cannot write: .*; .* write elsewhere", last
    )
    assert "Traceback" not in answer.err
    assert list(tmp_path.iterdir()) == [kitchen]


def test_ctrl_c_leaves_what_can_be_recovered(
    pglog: Pglog, kitchen: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(source: SevenScenesSource, index: int) -> SensorFrame:
        if index == 2:
            raise KeyboardInterrupt
        return original(source, index)

    original = SevenScenesSource.frame
    monkeypatch.setattr(SevenScenesSource, "frame", interrupted)
    log = tmp_path / "a.mcap"
    answer = pglog("record", "seven-scenes", kitchen, "-o", log)
    assert (answer.code, answer.out) == (130, "")
    assert answer.err.endswith(
        f"pglog: stopped; `pglog recover {log}.partial -o {log}` saves the frames so far: 1\n"
    )
    assert sorted(tmp_path.iterdir()) == [tmp_path / "a.mcap.partial", kitchen]


def test_a_real_ctrl_c(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "7scenes_redkitchen" / "seq-01"
    log = tmp_path / "a.mcap"
    command = [sys.executable, "-m", "pglog", "record", "seven-scenes", str(source)]
    with subprocess.Popen([*command, "-o", str(log)], stderr=subprocess.PIPE) as process:
        partial = log.with_name(log.name + ".partial")
        deadline = time.monotonic() + 60
        while not partial.exists() and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.01)
        assert not log.exists()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"Traceback" not in err
    assert not log.exists()
    assert partial.exists() == (b"pglog recover" in err)


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_a_data_set_is_not_overwritten_with_its_log(
    pglog: Pglog, tmp_path: Path, overwrite: tuple[str, ...]
) -> None:
    bag = tmp_path / "bag.mcap"
    bag.write_bytes(b"hours of work")
    answer = pglog("record", "ros2-bag", bag, "-o", tmp_path / "." / "bag.mcap", *overwrite)
    assert answer.code == 2
    assert "bag.mcap: the output is the data set to record; choose another name" in answer.err
    assert bag.read_bytes() == b"hours of work"


def test_auto_says_that_a_log_is_one_already(pglog: Pglog, room_log: Path, tmp_path: Path) -> None:
    answer = pglog("record", "auto", room_log, "-o", tmp_path / "a.mcap")
    assert answer.code == 2
    assert "room.mcap: is a log of pglog already; use it as it is" in answer.err
