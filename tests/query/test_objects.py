"""The objects of a perceived room: large ones where they are, alike in three forms."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pglog.objects import objects_command
from proground_log.errors import ProgroundError
from proground_log.evaluation.instance_scores import InstanceCounts, InstanceScores
from proground_log.evaluation.judge import evaluate_run
from proground_log.evaluation.objects import ObjectScores, object_table
from proground_log.exports.objects import object_rows
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.mapping.objects import SceneObject
from proground_log.perception.perceive import perceive
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.query.objects_of_labels import objects_of_labels
from proground_log.query.sightings import find_sightings
from proground_log.query.surface import Surfaces
from proground_log.run.folder import RunFolder
from proground_log.run.manifest import Manifest
from proground_log.run.opened import OpenedRun
from recorders.room import RoomSource
from replay.session import replay
from tests.query.asked_room import CONFIG, TASK, without_log
from tests.runs import surface_of_run

pytestmark = pytest.mark.slow

VOXEL_M = 0.06
UP = np.array([0.0, 0.0, 1.0])


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
    return surface_of_run(run, VOXEL_M).objects


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
    largest = max(objects, key=lambda thing: len(thing.vertices))
    assert largest.views > 1  # type: ignore[operator]


def test_they_come_in_the_order_of_prompts_and_scores(objects: list[SceneObject]) -> None:
    keys = [(TASK.prompts.index(thing.label), -thing.score) for thing in objects]
    assert keys == sorted(keys)


def test_without_its_log_a_run_lists_what_its_map_alone_tells_apart(
    run: Path, tmp_path: Path
) -> None:
    elsewhere = without_log(run, tmp_path)
    surface = surface_of_run(run, VOXEL_M)
    logits, background = surface.ask(surface.description.texts)
    of_map = objects_of_labels(surface.mesh, logits, background, TASK.prompts, UP, VOXEL_M)
    listed = surface_of_run(elsewhere, VOXEL_M).objects
    assert [thing.views for thing in listed] == [None] * len(of_map)
    for mine, other in zip(listed, of_map, strict=True):
        assert mine.label == other.label
        np.testing.assert_array_equal(mine.vertices, other.vertices)
        np.testing.assert_array_equal(mine.box.centre_m, other.box.centre_m)
    for class_name in ("sofa", "bed"):
        assert max(overlap(t, class_name) for t in listed if t.label == class_name) > 0.3
    with pytest.raises(ProgroundError, match="nowhere"):
        surface_of_run(elsewhere, VOXEL_M, Path("/nowhere.mcap"))


def test_who_lists_objects_of_the_map_alone_is_told_why(
    run: Path, room_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    objects_command(run, voxel_m=VOXEL_M)
    assert "warning" not in capsys.readouterr().err
    elsewhere = without_log(run, tmp_path / "gone")
    objects_command(elsewhere, voxel_m=VOXEL_M, as_json=True)
    gone = capsys.readouterr()
    assert "log is not at hand" in gone.err
    assert "--log" in gone.err
    # Another log where the run's was does not stop it, but naming that log does.
    manifest = Manifest.read(RunFolder(run).manifest)
    shutil.copytree(run, tmp_path / "run")
    replaced = RunFolder(tmp_path / "run")
    replace(manifest, log_path=str(room_log)).write(replaced.manifest)
    objects_command(replaced.path, voxel_m=VOXEL_M, as_json=True)
    other = capsys.readouterr()
    assert other.out == gone.out
    assert "another one" in other.err
    with pytest.raises(ProgroundError, match="check the path"):
        objects_command(replaced.path, voxel_m=VOXEL_M, log=room_log)


def test_a_log_that_has_moved_gives_the_same_objects(
    run: Path, objects: list[SceneObject], tmp_path: Path
) -> None:
    moved = tmp_path / "moved.mcap"
    shutil.copy(run.with_name("seen.mcap"), moved)
    found = surface_of_run(without_log(run, tmp_path), VOXEL_M, moved).objects
    assert object_rows(found) == object_rows(objects)


def test_only_frames_that_the_run_learnt_from_are_asked(run: Path, tmp_path: Path) -> None:
    log = LogReader(run.with_name("seen.mcap"))
    few = replace(CONFIG, steps=3, max_frames=6, hold_out_every=3)
    replay(run.with_name("seen.mcap"), tmp_path / "run", few)
    surface = surface_of_run(tmp_path / "run", VOXEL_M)
    assert surface.sightings is not None
    frames = map(Registration(log.calibration), log.frames([0, 1, 3, 4]))
    expected = find_sightings(surface.mesh.vertices_m, frames, VOXEL_M)
    assert surface.sightings.seen.shape[1] == 4
    np.testing.assert_array_equal(surface.sightings.seen.indices, expected.seen.indices)
    np.testing.assert_array_equal(surface.sightings.embeddings, expected.embeddings)


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
        assert entry["vertices"] == int(row["vertices"]) == len(thing.vertices)
        assert entry["views"] == int(row["views"]) == thing.views
        np.testing.assert_allclose(entry["box"]["extent_m"], thing.box.extent_m, atol=1e-3)
        assert float(row["box_centre_m_z"]) == entry["box"]["centre_m"][2]
    with pytest.raises(ProgroundError, match="--overwrite"):
        objects_command(run, voxel_m=VOXEL_M, csv=path)
    objects_command(run, voxel_m=VOXEL_M)
    table = capsys.readouterr().out
    assert all(thing.label in table for thing in objects)


def test_evaluate_judges_them_by_the_log_s_own_mesh(run: Path) -> None:
    result = evaluate_run(Surfaces(OpenedRun.finished(run)), VOXEL_M)
    truth = [o for o in RoomSource(frames=1).objects if o.class_name in TASK.prompts]
    # The mesh has what some view saw.
    assert 0 < result.scores["true_objects"] <= len(truth)
    assert result.instances["sofa"].matched[0.25] == 1
    assert set(result.instances) == set(TASK.prompts)
    assert result.scores["object_recall_at_iou_25_percent"] >= 40
    assert (
        result.scores["object_f1_at_iou_50_percent"] <= result.scores["object_f1_at_iou_25_percent"]
    )


def test_crowds_have_a_figure_of_their_own_where_there_are_some() -> None:
    def counts(true: int, found: int, matched: int) -> InstanceCounts:
        return InstanceCounts(true, found, {0.25: matched, 0.5: matched // 2})

    alone = InstanceScores(counts(10, 5, 4), {"cup": counts(8, 4, 4), "bed": counts(2, 1, 0)})
    crowded = InstanceScores(counts(40, 10, 5), {})
    table = object_table(ObjectScores(alone, crowded, in_crowds=30))
    assert (table["true_objects"], table["found_objects"], table["objects_in_crowds"]) == (
        10,
        5,
        30,
    )
    at = "at_iou_{}_percent".format
    assert table[f"object_precision_{at(25)}"] == pytest.approx(80)
    assert table[f"object_recall_{at(25)}"] == pytest.approx(40)
    assert table[f"object_f1_{at(25)}"] == pytest.approx(100 * 8 / 15)
    assert table[f"object_f1_{at(50)}"] == pytest.approx(100 * 4 / 15)
    assert table[f"object_f1_macro_{at(25)}"] == pytest.approx(100 * (8 / 12 + 0) / 2)
    assert table[f"object_f1_with_crowds_{at(25)}"] == pytest.approx(100 * 10 / 50)
    without = object_table(ObjectScores(alone, alone, in_crowds=0))
    assert set(table) - set(without) == {
        "objects_in_crowds",
        *(f"object_f1_with_crowds_{at(iou)}" for iou in (25, 50)),
    }


def test_what_has_no_objects_to_list_is_refused(run: Path, room_log: Path, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="voxels"):
        surface_of_run(run, 0.0)
    with pytest.raises(ProgroundError, match="no such run"):
        surface_of_run(tmp_path / "none", VOXEL_M)
    replay(room_log, tmp_path / "run", replace(CONFIG, max_frames=1, steps=1))
    with pytest.raises(ProgroundError, match="pglog perceive"):
        surface_of_run(tmp_path / "run", VOXEL_M)
