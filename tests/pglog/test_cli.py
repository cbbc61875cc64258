"""The commands as a user meets them: results on stdout, the rest on stderr, and exit codes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.frame import Selection, SensorFrame
from proground_log.log.reader import LogReader
from proground_log.regions import Regions
from proground_log.run.cost_model import DEFAULT_MODEL, CostModel
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig
from recorders.formats.seven_scenes import SevenScenesSource
from recorders.record import record
from recorders.registry import FORMATS
from recorders.room import RoomSource
from tests.commands import Answer, Pglog
from tests.full_disk import largest_file
from tests.perception.onnx.tiny_encoders import write_text_encoder
from tests.writers.small_source import SmallSource, with_frame, write_log

COMMANDS = [
    *("record", "info", "check", "recover", "perceive", "vocabulary"),
    *(
        "replay",
        "rerun",
        "diff",
        "bisect",
        "calibrate",
        "sweep",
        "ablate",
        "query",
        "objects",
        "navigate",
    ),
    *("evaluate", "report", "export", "view", "demo"),
]


@pytest.fixture(scope="module")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "a.mcap"
    return write_log(path, SmallSource(5, with_labels=True))


@pytest.fixture
def kitchen(shared_data: Path, tmp_path: Path) -> Path:
    """Four frames of a real sequence, to be spoiled."""
    folder = tmp_path / "kitchen"
    folder.mkdir()
    for path in sorted((shared_data / "7scenes_redkitchen" / "seq-01").iterdir())[:12]:
        shutil.copyfile(path, folder / path.name)
    return folder


def assert_one_clear_line(answer: Answer, *parts: str) -> None:
    """What, where and what to do in one line, and nothing else."""
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert re.fullmatch(r"pglog: .+: .+; .+\n", answer.err), answer.err
    for part in parts:
        assert part in answer.err


# Help.


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help(pglog: Pglog, command: str | None) -> None:
    answer = pglog(*filter(None, [command]), "--help")
    assert (answer.code, answer.err) == (0, "")
    assert f"usage: pglog {command or '[-h]'}" in answer.out
    assert "STR" not in answer.out.splitlines()[0]
    assert "None" not in answer.out
    if command is None:
        assert all(name in answer.out for name in COMMANDS)


@pytest.mark.parametrize("arguments", [[], ["fly"], ["info"], ["info", "a", "b"], ["info", "--x"]])
def test_a_wrong_command_line(pglog: Pglog, arguments: list[str]) -> None:
    answer = pglog(*arguments)
    assert (answer.code, answer.out) == (2, "")
    assert "Traceback" not in answer.err
    assert "--help" in answer.err


def test_version(pglog: Pglog) -> None:
    assert "--version" in pglog("--help").out
    answer = pglog("--version")
    assert answer == Answer(0, f"proground-log {version('proground-log')}\n", "")


def test_help_of_a_command_in_a_command(pglog: Pglog) -> None:
    answer = pglog("vocabulary", "build", "--help")
    assert (answer.code, answer.err) == (0, "")
    assert "usage: pglog vocabulary build" in answer.out


def test_help_waits_for_nothing_heavy() -> None:
    program = "import sys, pglog.commands; print([m for m in sys.argv[1:] if m in sys.modules])"
    heavy = ["torch", "onnxruntime", "rerun", "numba", "mcap", "kornia", "skimage"]
    result = subprocess.run(
        [sys.executable, "-c", program, *heavy], capture_output=True, text=True, check=True
    )
    assert result.stdout == "[]\n"


@pytest.mark.parametrize("command", ["record", "replay", "export", "demo", "perceive"])
def test_a_missing_output_is_asked_for(pglog: Pglog, command: str) -> None:
    given = {"record": ["tum", "x"], "export": ["x", "mesh"], "demo": []}
    answer = pglog(command, *given.get(command, ["x"]))
    assert answer.code == 2
    assert "-o PATH, --output PATH" in answer.err


# Recording.


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


# Perception.


TASK = """
name = "tidying"
prompts = ["chair", "sofa", "lamp"]
"""


@pytest.fixture
def task(tmp_path: Path) -> Path:
    path = tmp_path / "task.toml"
    path.write_text(TASK)
    return path


def test_perceive_simulated(pglog: Pglog, room_log: Path, task: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    answer = pglog("perceive", room_log, "--simulated", "--task", task, "-o", log)
    assert answer.code == 0
    assert "12/12" in answer.err
    for row in (r"task +│ tidying ", r"frames +│ 12 ", r"right +│ \d+\.\d% ", r"sofa +│ \d+ "):
        assert re.search(row, answer.out)
    reader = LogReader(log)
    assert reader.task is not None
    assert re.search(rf"regions +│ {reader.task.regions} \(\d+\.\d a frame\)", answer.out)
    share = re.search(r"right +│ (\d+)", answer.out)
    assert share is not None
    assert int(share[1]) > 40
    checked = pglog("check", log)
    assert (checked.code, checked.out) == (0, f"{log}: no fault found\n")
    table = pglog("info", log).out
    assert re.search(r"task +│ tidying: chair, sofa, lamp ", table)
    assert re.search(rf"regions +│ {reader.task.regions} ", table)
    found = json.loads(pglog("info", log, "--json").out)["task"]
    assert (found["name"], found["prompts"]) == ("tidying", ["chair", "sofa", "lamp"])
    assert found["regions"] == reader.task.regions
    assert json.loads(pglog("info", room_log, "--json").out)["task"] is None
    command = ["perceive", room_log, "--simulated", "--task", task, "-o"]
    assert pglog(*command, tmp_path / "b.mcap").code == 0
    assert pglog(*command, tmp_path / "c.mcap", "--simulated-seed", 1).code == 0
    first, again, other = ((tmp_path / f"{name}.mcap").read_bytes() for name in "abc")
    assert first == again != other


def test_perceive_everything(pglog: Pglog, room_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    answer = pglog("perceive", room_log, "--simulated", "-o", log)
    assert answer.code == 0
    reader = LogReader(log)
    assert reader.task is not None
    assert reader.task.name == "everything"
    classes = set(reader.label_names.values())
    assert classes - set(reader.task.prompts) >= {"wall", "floor", "ceiling"}
    assert {"chair", "sofa"} <= set(reader.task.prompts) <= classes


def test_perceive_with_a_detector(pglog: Pglog, shared_data: Path, tmp_path: Path) -> None:
    models = shared_data.parent / "models"
    if not models.is_dir():
        pytest.skip(f"no models in {models}")
    log, output, task = (tmp_path / name for name in ("a.mcap", "b.mcap", "t.toml"))
    task.write_text('name = "a"\nprompts = ["chair", "dining table"]')
    source = shared_data / "7scenes_redkitchen" / "seq-01"
    assert pglog("record", "seven-scenes", source, "-o", log, "--stop", 2).code == 0
    files = ["--detector", models / "yolov8n-seg-conse.onnx"]
    command = ["perceive", log, "--task", task, *files, "-o", output]
    vocabulary = ["--vocabulary", models / "clip-vit-b32-vocabulary.npz"]
    answer = pglog(*command, *vocabulary)
    assert answer.code == 0
    assert re.search(r"chair +│ [1-9]", answer.out)
    assert "right" not in answer.out
    assert pglog("check", output).code == 0
    task.write_text('name = "a"\nprompts = ["chiar"]')
    answer = pglog(*command, *vocabulary, "--overwrite")
    assert_one_clear_line(answer, "does not know 'chiar'", "'chair'")


def test_wrong_options_of_perceive(
    pglog: Pglog, small_log: Path, task: Path, tmp_path: Path
) -> None:
    detector = tmp_path / "d.onnx"
    detector.touch()
    for options, parts in (
        ([], ["there is no task; give one with --task"]),
        (["--task", task], ["there is no detector", "--simulated"]),
        (["--task", task, "--detector", detector], ["nothing embeds the prompts"]),
        (
            ["--task", task, "--detector", detector, "--vocabulary", "a", "--text-encoder", "b"],
            ["--vocabulary and --text-encoder are both given"],
        ),
        (["--simulated", "--detector", detector], ["--simulated has no use for --detector"]),
        (["--simulated-seed", 1], ["--simulated-seed is for --simulated"]),
        (["--simulated", "--task", "no.toml"], ["no.toml: no such file"]),
    ):
        answer = pglog("perceive", small_log, *options, "-o", tmp_path / "b.mcap")
        assert_one_clear_line(answer, *parts)
    for text, part in (
        ('name = "a"\nprompts = []', "has no prompts"),
        ('name = "a"\nprompts = ["cup", "Cup "]', "has the prompt 'cup' twice"),
        ('name = "a"\nprompts = [" "]', "has an empty text among its prompts"),
        ('name = "a', "is no TOML"),
    ):
        task.write_text(text)
        answer = pglog(
            *("perceive", small_log, "--task", task, "-o", tmp_path / "b.mcap", "--simulated")
        )
        assert_one_clear_line(answer, part, "task.toml")
    assert sorted(tmp_path.iterdir()) == [detector, task]


def test_perceive_simulated_needs_labels(pglog: Pglog, tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap")
    answer = pglog("perceive", log, "--simulated", "-o", tmp_path / "b.mcap")
    assert_one_clear_line(answer, "a.mcap: has no ground-truth labels, which --simulated needs")
    assert list(tmp_path.iterdir()) == [log]


def test_a_perception_that_exists(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    output = tmp_path / "b.mcap"
    output.touch()
    answer = pglog("perceive", small_log, "--simulated", "-o", output)
    assert_one_clear_line(answer, "b.mcap: the output exists")


def test_ctrl_c_keeps_what_was_perceived(
    pglog: Pglog, room_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from proground_log.perception.simulated.perceiver import SimulatedPerception

    def interrupted(perceiver: SimulatedPerception, frame: SensorFrame) -> Regions:
        if frame.index == 7:
            raise KeyboardInterrupt
        return original(perceiver, frame)

    original, command = SimulatedPerception.__call__, ["perceive", room_log, "--simulated", "-o"]
    with monkeypatch.context() as patch:
        patch.setattr(SimulatedPerception, "__call__", interrupted)
        answer = pglog(*command, tmp_path / "a.mcap")
    assert (answer.code, answer.out) == (130, "")
    assert answer.err.endswith("pglog: stopped; run the same command again to go on\n")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.regions.partial"]
    assert pglog(*command, tmp_path / "a.mcap").code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert pglog(*command, tmp_path / "b.mcap").code == 0
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_build_a_vocabulary(pglog: Pglog, tmp_path: Path) -> None:
    names, encoder, output = (tmp_path / name for name in ("n.txt", "e.onnx", "v.npz"))
    names.write_text("chair\nsofa  # a comment\n")
    write_text_encoder(encoder)
    command = ["vocabulary", "build", names, "--text-encoder", encoder, "-o", output]
    answer = pglog(*command)
    assert (answer.code, answer.out) == (0, f"{output}: 2 names\n")
    assert "2/2" in answer.err
    with np.load(output) as vocabulary:
        assert vocabulary["names"].tolist() == ["chair", "sofa"]
        assert vocabulary["embeddings"].shape == (2, 512)
    names.write_text("chair\nChair\n")
    answer = pglog(*command, "--overwrite")
    assert_one_clear_line(answer, "n.txt: has the name 'Chair' twice")


def test_wrong_options_of_vocabulary(pglog: Pglog, tmp_path: Path) -> None:
    names, encoder, output = (tmp_path / name for name in ("n.txt", "e.onnx", "v.npz"))
    command = ["vocabulary", "build", names, "--text-encoder", encoder, "-o", output]
    assert_one_clear_line(pglog(*command), "e.onnx: no such file")
    output.touch()
    assert_one_clear_line(pglog(*command), "v.npz: the output exists")


# Faults of a log.


def test_faults_are_listed(pglog: Pglog, tmp_path: Path) -> None:
    source = SmallSource(5)
    broken = source.frame(3).color[:-100]
    frames = with_frame(source, 3, color=broken)
    log = write_log(tmp_path / "a.mcap", source, frames=frames, announced=7)
    answer = pglog("check", log)
    assert answer.code == 1
    assert answer.out.startswith(f"{log}: 2 faults\n")
    assert re.search(r"3 +│ /camera/color/image │ the png image is cut short", answer.out)
    assert "5 frames found, 7 announced" in answer.out
    answer = pglog("check", log, "--json")
    assert answer.code == 1
    assert json.loads(answer.out)[0] == {
        "frame": "3",
        "topic": "/camera/color/image",
        "what": "the png image is cut short or damaged",
    }


def test_one_fault_is_not_several(pglog: Pglog, tmp_path: Path) -> None:
    answer = pglog("check", write_log(tmp_path / "a.mcap", announced=6))
    assert "a.mcap: 1 fault\n" in answer.out


def test_names_are_printed_as_they_are(pglog: Pglog, tmp_path: Path) -> None:
    log = tmp_path / "[bold]room :cat:.mcap"
    write_log(log, SmallSource(2, notes={"[red]": ":dog: [/]"}))
    for command in ("info", "check"):
        assert str(log) in pglog(command, log).out
    assert "[red]" in pglog("info", log).out
    assert ":dog: [/]" in pglog("info", log).out


def test_info_shows_what_looks_wrong_about_a_recording(
    pglog: Pglog, small_log: Path, tmp_path: Path
) -> None:
    source = SmallSource(3, warnings=("the lens cap is on", "the floor is lava"))
    log = tmp_path / "odd.mcap"
    record(source, "odd", log, Selection(), overwrite=False, progress=lambda *_: None)
    rows = pglog("info", log).out.splitlines()
    (first,) = (n for n, row in enumerate(rows) if row.startswith("│ warnings"))
    assert "the lens cap is on" in rows[first]
    assert "the floor is lava" in rows[first + 1]
    assert "warnings" not in pglog("info", small_log).out
    shown = [json.loads(pglog("info", name, "--json").out)["warnings"] for name in (log, small_log)]
    assert shown == [["the lens cap is on", "the floor is lava"], []]


@pytest.mark.parametrize("columns", [20, 40, 80])
def test_narrow_terminals_lose_nothing(
    pglog: Pglog, small_log: Path, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    _, *lines = pglog("info", small_log).out.splitlines()  # The first is the path.
    assert max(map(len, lines)) <= columns
    assert "…" not in "".join(lines)


# Errors: one clear line, exit code 2, nothing half-written.


def reading_commands(path: Path, free: Path) -> list[list[object]]:
    return [
        ["info", path],
        ["check", path],
        ["replay", path, "-o", free],
        ["perceive", path, "--simulated", "-o", free],
        ["view", path],
    ]


def test_a_missing_log(pglog: Pglog, tmp_path: Path) -> None:
    *commands, view = reading_commands(tmp_path / "no.mcap", tmp_path / "run")
    for command in commands:
        assert_one_clear_line(pglog(*command), "no.mcap: no such file; check the path")
    assert_one_clear_line(pglog(*view), "no.mcap: no such log or run; check the path")
    assert_one_clear_line(pglog("view", tmp_path, tmp_path / "no"), "no: no such log or run")
    assert not (tmp_path / "run").exists()


def test_a_folder_in_place_of_a_log(pglog: Pglog, tmp_path: Path) -> None:
    for command in reading_commands(tmp_path, tmp_path / "run"):
        assert_one_clear_line(pglog(*command), f"{tmp_path}: ", "folder")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_log(pglog: Pglog, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_text("time,x\n" * 100)
    for command in reading_commands(log, tmp_path / "run")[:4]:
        assert_one_clear_line(pglog(*command), "a.mcap: is no MCAP file")


def test_a_log_that_was_cut_off(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(small_log.read_bytes()[:-500])
    for command in reading_commands(log, tmp_path / "run")[:4]:
        assert_one_clear_line(pglog(*command), "a.mcap: the file is cut off; copy or record it")
    assert list(tmp_path.iterdir()) == [log]


def test_a_log_of_another_version(
    pglog: Pglog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("proground_log.log.recording.SCHEMA_VERSION", "9")
        log = write_log(tmp_path / "a.mcap")
    for command in reading_commands(log, tmp_path / "run")[:4]:
        answer = pglog(*command)
        assert_one_clear_line(answer, "the log has schema version 9, this pglog reads 1; record it")


def test_nothing_to_view(pglog: Pglog) -> None:
    assert_one_clear_line(pglog("view"), "there is nothing to open")


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


@pytest.mark.parametrize("format", ["auto", *FORMATS])
def test_help_of_a_format(pglog: Pglog, format: str) -> None:
    assert f" {format} " in pglog("record", "--help").out
    answer = pglog("record", format, "--help")
    assert (answer.code, answer.err) == (0, "")
    assert f"usage: pglog record {format} " in answer.out
    assert ("--color-topic" in answer.out) == (format in ("ros1-bag", "ros2-bag"))
    assert ("--calibration" in answer.out) == ("SOURCE" in answer.out) == (format != "synthetic")


def test_formats_are_listed_without_their_modules() -> None:
    program = (
        "import sys, pglog.commands\n"
        "sys.argv = ['pglog', 'record', '--help']\n"
        "try: pglog.commands.main()\n"
        "except SystemExit: print([m for m in sys.modules if m.startswith('recorders.formats')])"
    )
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.endswith("\n[]\n")


def test_typos_are_told_by_the_command_at_hand(pglog: Pglog) -> None:
    answer = pglog("replay", "--budgte-ms", 5)
    assert_one_clear_line(answer, "replay: there is no option --budgte-ms", "mean --budget-ms?")
    assert "sweep" not in answer.err
    for words in (["nonsense"], ["nonsense", "--help"], ["vocabulary", "nonsense", "--help"]):
        assert_one_clear_line(pglog(*words), "there is no `pglog", "nonsense`; the nearest are ")
    assert_one_clear_line(pglog("reply", "x"), "the nearest are replay,")


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
    write_png(path, np.ones((240, 320), np.uint16))
    return path


def remove_color(folder: Path) -> Path:
    path = sorted(folder.glob("*.color.*"))[2]
    path.unlink()
    return path.with_suffix("")


def write_png(path: Path, image: np.ndarray) -> None:
    import cv2

    cv2.imwrite(str(path), image)


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


def test_a_reader_that_has_seen_enough(small_log: Path) -> None:
    command = [sys.executable, "-m", "pglog", "info", str(small_log), "--json"]
    read, write = os.pipe()
    os.close(read)  # As `head` does when it has its lines.
    try:
        result = subprocess.run(
            command, stdout=write, stderr=subprocess.PIPE, text=True, check=False
        )
    finally:
        os.close(write)
    assert result.stderr == ""
    assert result.returncode == 2


# Runs.


def run_commands(run: Path, output: Path) -> list[list[object]]:
    return [
        ["evaluate", run],
        ["export", run, "mesh", "-o", output],
        ["diff", run, run],
    ]


def test_what_is_no_run(pglog: Pglog, tmp_path: Path, small_log: Path) -> None:
    output = tmp_path / "a.ply"
    for command in run_commands(tmp_path / "no", output):
        assert_one_clear_line(pglog(*command), "no: no such run; check the path")
    for command in run_commands(tmp_path, output):
        assert_one_clear_line(pglog(*command), "is not a finished run; make one with `pglog replay")
    for command in run_commands(small_log, output):
        assert_one_clear_line(pglog(*command), "no such run")
    model = CostModel.load(DEFAULT_MODEL)
    manifest = Manifest.of(small_log, ReplayConfig(), model, "cpu", None)
    manifest.write(tmp_path / "manifest.json")
    finish = f"finish it with `pglog replay {small_log} -o {tmp_path} --resume`"
    for command in run_commands(tmp_path, output):
        assert_one_clear_line(pglog(*command), f"is not a finished run; {finish}")
    assert_one_clear_line(pglog("view", tmp_path), "the folder has no telemetry.rrd")
    assert not output.exists()


def test_an_unknown_export(pglog: Pglog, tmp_path: Path) -> None:
    answer = pglog("export", tmp_path, "stl", "-o", tmp_path / "a.stl")
    assert (answer.code, answer.out) == (2, "")
    assert "'stl'" in answer.err
    assert "'mesh', 'points'" in answer.err


def test_an_export_that_exists(pglog: Pglog, tmp_path: Path) -> None:
    output = tmp_path / "a.ply"
    output.touch()
    answer = pglog("export", tmp_path, "mesh", "-o", output)
    assert_one_clear_line(answer, "a.ply: the output exists")


def test_wrong_options_of_replay(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    for options, part in (
        (["--threads", 0], "0 threads cannot compute; use 1 or more"),
        (["--start", 9], "a recording of 5 frames: start 9"),
        (["--resume"], "there is no run to resume"),
    ):
        assert_one_clear_line(pglog("replay", small_log, "-o", run, *options), part)
        assert not run.exists()


def test_an_unknown_device(pglog: Pglog, small_log: Path, tmp_path: Path) -> None:
    answer = pglog("replay", small_log, "-o", tmp_path / "run", "--device", "tpu")
    assert (answer.code, answer.out) == (2, "")
    assert "'tpu'" in answer.err
    assert "('auto', 'cpu', 'cuda')" in answer.err


@pytest.mark.long
def test_a_log_is_mapped_judged_exported_and_compared(
    pglog: Pglog, room_log: Path, tmp_path: Path
) -> None:
    runs = [tmp_path / "one", tmp_path / "two"]
    options = ["--steps", 4, "--stop", 5, "--hold-out-every", 4]
    for run, seed in zip(runs, (0, 1), strict=True):
        answer = pglog("replay", room_log, "-o", run, *options, "--seed", seed)
        assert answer.code == 0
        assert "5/5" in answer.err
        assert re.search(r"frames mapped +│ 4 ", answer.out)
    assert_one_clear_line(pglog("replay", room_log, "-o", runs[0]), "the output exists")
    answer = pglog("evaluate", runs[0], "--json", "--voxel-m", 0.2)
    assert answer.code == 0
    assert json.loads(answer.out)["views"] == 1
    mesh = tmp_path / "a.ply"
    answer = pglog("export", runs[0], "mesh", "-o", mesh, "--voxel-m", 0.2)
    assert answer.code == 0
    assert re.fullmatch(rf"{re.escape(str(mesh))}: \d+ vertices, \d+ faces\n", answer.out)
    same, other = pglog("diff", runs[0], runs[0]), pglog("diff", *runs)
    assert (same.code, same.out) == (0, "the runs are equal, bit for bit\n")
    assert other.code == 1
    assert "config.seed: 0 | 1" in other.out
    assert "first difference: " in other.out
    moved = tmp_path / "moved.mcap"
    write_log(moved)
    answer = pglog("evaluate", runs[0], "--log", moved)
    assert_one_clear_line(answer, "moved.mcap: is not the log that the run was made of")
