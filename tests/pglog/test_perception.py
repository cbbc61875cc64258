"""`pglog perceive` and `pglog vocabulary`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from proground_log.frame import SensorFrame
from proground_log.log.reader import LogReader
from proground_log.regions import Regions
from tests.commands import Pglog, assert_one_clear_line
from tests.perception.onnx.tiny_encoders import write_text_encoder
from tests.writers.small_source import write_log

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
