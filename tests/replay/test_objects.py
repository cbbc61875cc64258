"""The objects of a perceived room: large ones where they are, alike in three forms."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proground_log.cli.objects import objects_command
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.perception.perceive import perceive
from proground_log.perception.simulated import SimulatedPerception
from proground_log.query.objects import SceneObject
from recorders.room import RoomSource
from replay.evaluate import evaluate_run
from replay.manifest import Manifest
from replay.objects import objects_of_run
from replay.run_folder import RunFolder
from replay.session import replay
from tests.replay.test_query import CONFIG, TASK

VOXEL_M = 0.06


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the room with perfect regions; read it, do not change it."""
    folder = tmp_path_factory.mktemp("objects")
    reader = LogReader(room_log)
    camera = reader.calibration.color
    perceiver = SimulatedPerception(TASK, reader.label_names, camera, seed=0, strength=0.0)
    seen = folder / "seen.mcap"
    perceive(room_log, perceiver, seen, overwrite=False, progress=lambda *_: None)
    replay(seen, folder / "run", CONFIG)
    return folder / "run"


@pytest.fixture(scope="module")
def objects(run: Path) -> list[SceneObject]:
    return objects_of_run(run, VOXEL_M)


def overlap(thing: SceneObject, class_name: str) -> float:
    """The best IoU of an object's box, along the world's axes, with a true one's of a class."""
    lower_m, upper_m = thing.box.corners_m.min(axis=0), thing.box.corners_m.max(axis=0)
    best = 0.0
    for true in RoomSource(frames=1).objects:
        if true.class_name != class_name:
            continue
        sides_m = np.minimum(upper_m, true.upper_m) - np.maximum(lower_m, true.lower_m)
        shared = float(np.prod(sides_m.clip(min=0)))
        whole = np.prod(upper_m - lower_m) + np.prod(np.subtract(true.upper_m, true.lower_m))
        best = max(best, shared / (float(whole) - shared))
    return best


def test_large_objects_are_where_and_as_large_as_they_are(objects: list[SceneObject]) -> None:
    for class_name in ("sofa", "bed"):
        things = [thing for thing in objects if thing.label == class_name]
        assert max(overlap(thing, class_name) for thing in things) > 0.4
    for thing in objects:
        np.testing.assert_array_equal(thing.box.axes[2], (0, 0, 1))
        assert thing.views is not None
        assert 0 <= thing.views <= 12
    assert {thing.label for thing in objects} <= set(TASK.prompts)
    largest = max(objects, key=lambda thing: len(thing.instance))
    assert largest.views > 1  # type: ignore[operator]


def test_they_come_in_the_order_of_prompts_and_scores(objects: list[SceneObject]) -> None:
    keys = [(TASK.prompts.index(thing.label), -thing.instance.score) for thing in objects]
    assert keys == sorted(keys)


def test_without_its_log_a_run_lists_the_same_but_for_views(
    run: Path, objects: list[SceneObject], tmp_path: Path
) -> None:
    shutil.copytree(run, tmp_path / "run")
    manifest = Manifest.read(RunFolder(run).manifest)
    replace(manifest, log_path="/nowhere.mcap").write(RunFolder(tmp_path / "run").manifest)
    alone = objects_of_run(tmp_path / "run", VOXEL_M)
    assert [thing.views for thing in alone] == [None] * len(objects)
    for mine, other in zip(alone, objects, strict=True):
        np.testing.assert_array_equal(mine.instance.vertices, other.instance.vertices)
        np.testing.assert_array_equal(mine.box.centre_m, other.box.centre_m)
    with pytest.raises(ProgroundError, match="nowhere"):
        objects_of_run(tmp_path / "run", VOXEL_M, Path("/nowhere.mcap"))


def test_table_json_and_csv_say_the_same(
    run: Path, objects: list[SceneObject], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "objects.csv"
    assert objects_command(run, voxel_m=VOXEL_M, as_json=True, csv=path) == 0
    printed = json.loads(capsys.readouterr().out)
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(printed) == len(rows) == len(objects)
    for number, (entry, row, thing) in enumerate(zip(printed, rows, objects, strict=True), 1):
        assert (entry["number"], entry["label"]) == (number, thing.label)
        assert (int(row["number"]), row["label"]) == (number, thing.label)
        assert entry["vertices"] == int(row["vertices"]) == len(thing.instance)
        assert entry["views"] == int(row["views"]) == thing.views
        np.testing.assert_allclose(entry["box"]["extent_m"], thing.box.extent_m, atol=1e-3)
        assert float(row["box_centre_m_z"]) == entry["box"]["centre_m"][2]
    with pytest.raises(ProgroundError, match="--overwrite"):
        objects_command(run, voxel_m=VOXEL_M, csv=path)
    objects_command(run, voxel_m=VOXEL_M)
    table = capsys.readouterr().out
    assert all(thing.label in table for thing in objects)


def test_evaluate_judges_them_by_the_log_s_own_mesh(run: Path) -> None:
    result = evaluate_run(run, None, VOXEL_M, lambda *_: None)
    truth = [o for o in RoomSource(frames=1).objects if o.class_name in TASK.prompts]
    # The mesh has what some view saw.
    assert 0 < result.scores["true_objects"] <= len(truth)
    assert result.instances["sofa"].matched[0.25] == 1
    assert set(result.instances) == set(TASK.prompts)
    assert result.scores["object_recall_at_iou_25_percent"] >= 40
    assert (
        result.scores["object_f1_at_iou_50_percent"] <= result.scores["object_f1_at_iou_25_percent"]
    )


def test_what_has_no_objects_to_list_is_refused(run: Path, room_log: Path, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="voxels"):
        objects_of_run(run, 0.0)
    with pytest.raises(ProgroundError, match="no such run"):
        objects_of_run(tmp_path / "none", VOXEL_M)
    replay(room_log, tmp_path / "run", replace(CONFIG, max_frames=1, steps=1))
    with pytest.raises(ProgroundError, match="pglog perceive"):
        objects_of_run(tmp_path / "run", VOXEL_M)
