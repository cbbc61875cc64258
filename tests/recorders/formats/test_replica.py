from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.errors import ProgroundError
from recorders.formats.replica import ReplicaSource
from tests.writers.replica import NUMBERS, PARAMS, PLY, write_scene


def test_frames_come_back_exactly_in_any_order(tmp_path: Path) -> None:
    written = write_scene(tmp_path)
    source = ReplicaSource(tmp_path)
    assert len(source) == 3
    for index in (2, 0, 1):
        frame, number = source.frame(index), NUMBERS[index]
        depth, classes, pose = written[number]
        assert frame.depth.dtype == np.float32
        np.testing.assert_array_equal(frame.depth, (depth / np.float32(6553.5)))
        np.testing.assert_array_equal(frame.world_from_camera, pose)
        assert frame.labels is not None
        assert frame.labels.dtype == np.uint16
        np.testing.assert_array_equal(frame.labels, classes)
        assert frame.color == (tmp_path / f"results/frame{number:06d}.jpg").read_bytes()
        assert (frame.index, frame.stamp_ns) == (index, number * 10**9 // 30)
    assert source.label_names == {3: "red lamp", 7: "chair"}
    assert source.ground_truth_mesh() == PLY
    camera = source.calibration.depth
    assert source.calibration.is_registered
    # 15.5 is the middle of 32 pixels whose centres are whole numbers; with centres at +0.5, 16 is.
    assert (camera.cx, camera.cy, camera.fx, camera.fy) == (16.0, 12.0, 30.0, 31.0)


def test_without_ground_truth(tmp_path: Path) -> None:
    write_scene(tmp_path / "scene", labels=False)
    (tmp_path / "scene/cam_params.json").rename(tmp_path / "cam_params.json")
    source = ReplicaSource(tmp_path / "scene")
    assert source.label_names == {}
    assert source.frame(0).labels is None
    assert source.ground_truth_mesh() is None


def test_instances_are_kept_as_they_are(tmp_path: Path) -> None:
    write_scene(tmp_path)
    assert ReplicaSource(tmp_path).frame(0).instances is None
    (tmp_path / "semantic_instance").mkdir()
    things = np.arange(24 * 32, dtype=np.uint16).reshape(24, 32) * 80
    for number in NUMBERS:
        cv2.imwrite(str(tmp_path / f"semantic_instance/semantic_instance_{number}.png"), things)
    frame = ReplicaSource(tmp_path).frame(1)
    assert frame.instances is not None
    assert frame.instances.dtype == np.uint16
    np.testing.assert_array_equal(frame.instances, things)
    (tmp_path / "semantic_instance/semantic_instance_2.png").unlink()
    with pytest.raises(ProgroundError, match=r"semantic_instance_2\.png: is missing"):
        ReplicaSource(tmp_path)


def test_of_two_meshes_none_is_taken(tmp_path: Path) -> None:
    write_scene(tmp_path)
    (tmp_path / "mesh_semantic_observed.ply").write_bytes(PLY)
    assert ReplicaSource(tmp_path).ground_truth_mesh() is None


@pytest.mark.parametrize(
    "name",
    [
        "cam_params.json",
        "traj.txt",
        "results/frame000002.jpg",
        "semantic_class/semantic_class_2.png",
        "info_semantic.json",
    ],
)
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    write_scene(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(ProgroundError, match=name):
        ReplicaSource(tmp_path)


def test_empty_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match=r"cam_params\.json: no such file"):
        ReplicaSource(tmp_path)
    write_scene(tmp_path)
    for path in (tmp_path / "results").iterdir():
        path.unlink()
    with pytest.raises(ProgroundError, match=r"results: has no images such as depth000000\.png"):
        ReplicaSource(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cam_params.json", "{", "is not JSON"),
        ("cam_params.json", "[]", "does not describe the camera"),
        ("cam_params.json", json.dumps({"camera": PARAMS | {"fx": "wide"}}), "the camera"),
        ("cam_params.json", json.dumps({"camera": PARAMS | {"scale": 0}}), "above 0"),
        ("info_semantic.json", '{"classes": [{"id": 1}]}', "does not name the classes"),
        ("traj.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", r"traj\.txt:3: is missing"),
    ],
)
def test_a_broken_text_file_is_named(tmp_path: Path, name: str, content: str, message: str) -> None:
    write_scene(tmp_path)
    (tmp_path / name).write_text(content)
    with pytest.raises(ProgroundError, match=message) as caught:
        ReplicaSource(tmp_path)
    assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize(
    ("row", "message"), [("nan " * 16, "not finite"), ("2 " * 16, "not rigid"), ("1 2", "16")]
)
def test_a_broken_pose_is_named_by_its_line(tmp_path: Path, row: str, message: str) -> None:
    write_scene(tmp_path)
    lines = (tmp_path / "traj.txt").read_text().splitlines()
    (tmp_path / "traj.txt").write_text("\n".join([*lines[:2], row, *lines[3:]]))
    with pytest.raises(ProgroundError, match=rf"traj\.txt:3: .*{message}"):
        ReplicaSource(tmp_path)


@pytest.mark.parametrize("name", ["results/frame000002.jpg", "results/depth000002.png"])
def test_a_truncated_image_is_named(tmp_path: Path, name: str) -> None:
    write_scene(tmp_path)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-9])
    with pytest.raises(ProgroundError, match=name):
        ReplicaSource(tmp_path).frame(1)


def test_the_small_house(shared_data: Path, depth_agreement: Callable[..., float]) -> None:
    source = ReplicaSource(shared_data / "aws_small_house_labelled")
    assert len(source) == 220
    assert len(source.label_names) == 38
    assert source.label_names[3] == "bed"
    first, later = source.frame(0), source.frame(1)
    assert depth_agreement(source, first, later, 0.05) > 0.95
    assert first.labels is not None
    assert first.instances is not None
    for thing in np.unique(first.instances[first.instances > 0]):
        assert len(np.unique(first.labels[first.instances == thing])) == 1
    assert first.instances.max() > len(source.label_names)
    assert set(np.unique(first.labels)) - {0} <= set(source.label_names)
    mesh = source.ground_truth_mesh()
    assert mesh is not None
    assert mesh.startswith(b"ply\nformat binary_little_endian")
