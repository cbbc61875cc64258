from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.frame import SensorFrame
from recorders.formats.replica import recognise as recognise_nice_slam
from recorders.formats.replica_semantic import ReplicaSemanticSource, recognise
from recorders.reading.images import encoded_png
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.replica_semantic import FIRST, semantic_frame, write_sequence

PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    b"property float z\nproperty ushort label\nelement face 0\n"
    b"property list uchar int vertex_indices\nend_header\n1 2 3 4\n"
)
FACES_ONLY = PLY.replace(b"property ushort label\n", b"").replace(
    b"property list uchar int vertex_indices\n",
    b"property list uchar int vertex_indices\nproperty int label\n",
)


@pytest.fixture(scope="module")
def frames(room_frames: list[SensorFrame]) -> list[SensorFrame]:
    return [semantic_frame(frame) for frame in room_frames]


@pytest.fixture
def sequence(tmp_path: Path, frames: list[SensorFrame], room: RoomSource) -> Path:
    return write_sequence(tmp_path / "room_0" / "imap" / "00", frames, room.label_names)


def test_frames_come_back_in_the_order_of_their_numbers(
    sequence: Path, frames: list[SensorFrame], room: RoomSource, tmp_path: Path
) -> None:
    (sequence / "mesh_semantic.ply").write_bytes(PLY)
    source = ReplicaSemanticSource(sequence, calibration=room.calibration)
    assert source.label_names == {label: name for label, name in room.label_names.items() if label}
    reader = assert_round_trip(source, frames, tmp_path / "a.mcap")
    for frame, wanted in zip(reader.frames(), frames, strict=True):
        assert frame.depth.dtype == np.uint16
        assert wanted.labels is not None
        assert wanted.instances is not None
        np.testing.assert_array_equal(frame.labels, wanted.labels)
        np.testing.assert_array_equal(frame.instances, wanted.instances)
    assert reader.stamps_ns() == [(FIRST + i) * 10**9 // 30 for i in range(6)]
    mesh = source.ground_truth_mesh()
    assert mesh is not None
    assert read_labelled_mesh(mesh, where="mesh")[1].tolist() == [4]


def test_classes_follow_from_instances(
    sequence: Path, frames: list[SensorFrame], room: RoomSource
) -> None:
    for path in (sequence / "semantic_class").iterdir():
        path.unlink()
    (sequence / "semantic_class").rmdir()
    source = ReplicaSemanticSource(sequence, calibration=room.calibration)
    for index, wanted in enumerate(frames):
        assert wanted.labels is not None
        np.testing.assert_array_equal(source.frame(index).labels, wanted.labels)
    info = json.loads((sequence / "info_semantic.json").read_text())
    short = info | {"id_to_label": info["id_to_label"][:302]}
    (sequence / "info_semantic.json").write_text(json.dumps(short))
    source = ReplicaSemanticSource(sequence, calibration=room.calibration)
    with pytest.raises(ProgroundError, match=r"semantic_instance_7\.png: has instance 3\d\d"):
        source.frame(0)


def test_without_ground_truth(sequence: Path, room: RoomSource) -> None:
    for name in ("semantic_class", "semantic_instance"):
        (sequence / name).rename(sequence / f"no_{name}")
    (sequence / "info_semantic.json").unlink()
    source = ReplicaSemanticSource(sequence, calibration=room.calibration)
    frame = source.frame(0)
    assert (frame.labels, frame.instances, source.label_names) == (None, None, {})
    assert source.ground_truth_mesh() is None


@pytest.mark.parametrize(
    "place",
    [
        "room_0/imap/info_semantic.json",
        "room_0/info_semantic.json",
        "room_0/habitat/info_semantic.json",
        "room_0/imap/habitat/info_semantic.json",
        "room_0/semantic_info/imap/info_semantic.json",
    ],
)
def test_names_are_found_where_the_data_sets_have_them(
    sequence: Path, room: RoomSource, tmp_path: Path, place: str
) -> None:
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (sequence / "info_semantic.json").rename(tmp_path / place)
    source = ReplicaSemanticSource(sequence, calibration=room.calibration)
    assert source.label_names == {label: name for label, name in room.label_names.items() if label}


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((1200, 680), Camera.from_integer_centres(1200, 680, 600.0, 600.0, 599.5, 339.5)),
        ((640, 480), Camera.from_integer_centres(640, 480, 320.0, 320.0, 319.5, 239.5)),
    ],
)
def test_the_camera_is_known_by_the_size(
    sequence: Path, size: tuple[int, int], expected: Camera
) -> None:
    width, height = size
    first = sequence / f"rgb/rgb_{FIRST}.png"
    first.write_bytes(encoded_png(np.zeros((height, width, 3), np.uint8)))
    assert ReplicaSemanticSource(sequence).calibration == Calibration.registered(expected)


def test_an_unknown_size_asks_for_the_calibration(sequence: Path) -> None:
    with pytest.raises(ProgroundError, match=r"rgb_7\.png: is 320x240.* 1200x680 .vMAP") as caught:
        ReplicaSemanticSource(sequence)
    assert "pass the calibration" in caught.value.todo


@pytest.mark.parametrize(
    "name",
    [
        "traj_w_c.txt",
        "rgb/rgb_10.png",
        "semantic_class/semantic_class_12.png",
        "semantic_instance/semantic_instance_8.png",
        "info_semantic.json",
    ],
)
def test_a_missing_file_is_named(sequence: Path, room: RoomSource, name: str) -> None:
    (sequence / name).unlink()
    with pytest.raises(ProgroundError) as caught:
        ReplicaSemanticSource(sequence, calibration=room.calibration)
    assert caught.value.where == str(sequence / name)


def test_a_short_trajectory_and_no_depth_are_named(sequence: Path, room: RoomSource) -> None:
    trajectory = sequence / "traj_w_c.txt"
    trajectory.write_text("\n".join(trajectory.read_text().splitlines()[:9]))
    with pytest.raises(ProgroundError, match=r"traj_w_c\.txt:10: is missing"):
        ReplicaSemanticSource(sequence, calibration=room.calibration)
    for path in (sequence / "depth").iterdir():
        path.unlink()
    with pytest.raises(ProgroundError, match=r"depth: has no images such as depth_0\.png"):
        ReplicaSemanticSource(sequence, calibration=room.calibration)


@pytest.mark.parametrize(
    "labels", ["[1e999999999]", "[70000]", "{}}", "null", '["x"]', "[" * 9999, "[NaN]"]
)
def test_broken_classes_of_instances_are_named(
    sequence: Path, room: RoomSource, labels: str
) -> None:
    (sequence / "semantic_class").rename(sequence / "no_semantic_class")
    (sequence / "info_semantic.json").write_text(f'{{"classes": [], "id_to_label": {labels}}}')
    with pytest.raises(ProgroundError) as caught:
        ReplicaSemanticSource(sequence, calibration=room.calibration)
    assert caught.value.where == str(sequence / "info_semantic.json")


@pytest.mark.parametrize("classes", ['[{"id": 1e999999999, "name": "a"}]', "7", '[{"name": "a"}]'])
def test_broken_class_names_are_named(sequence: Path, room: RoomSource, classes: str) -> None:
    (sequence / "info_semantic.json").write_text(f'{{"classes": {classes}}}')
    with pytest.raises(ProgroundError, match="does not name the classes"):
        ReplicaSemanticSource(sequence, calibration=room.calibration)


@pytest.mark.parametrize(
    ("meshes", "note"),
    [
        ({"mesh_semantic.ply": FACES_ONLY}, "the vertices of mesh_semantic.ply have no labels"),
        ({"mesh_semantic.ply": b"\xff" * 99}, "have no labels"),
        ({"mesh_semantic.ply": PLY, "room_mesh_semantic_2.ply": PLY}, "there are 2"),
    ],
)
def test_a_mesh_that_cannot_be_judged_by_is_left_out(
    sequence: Path, room: RoomSource, meshes: dict[str, bytes], note: str
) -> None:
    for name, content in meshes.items():
        (sequence / name).write_bytes(content)
    source = ReplicaSemanticSource(sequence, calibration=room.calibration)
    assert source.ground_truth_mesh() is None
    assert note in source.notes["mesh"]


def test_the_two_layouts_are_told_apart(sequence: Path, tmp_path: Path, shared_data: Path) -> None:
    reason = recognise(sequence)
    assert reason is not None
    assert "traj_w_c.txt" in reason
    assert recognise_nice_slam(sequence) is None
    house = shared_data / "aws_small_house_labelled"
    assert recognise_nice_slam(house) is not None
    for path in (house, tmp_path, tmp_path / "missing", sequence / "traj_w_c.txt"):
        assert recognise(path) is None


def test_the_house_in_this_layout(shared_data: Path, tmp_path: Path) -> None:
    """Its label images are those of this layout; colour and depth are written anew."""
    house, folder = shared_data / "aws_small_house_labelled", tmp_path / "Sequence_1"
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for name in ("semantic_class", "semantic_instance", "info_semantic.json"):
        (folder / name).symlink_to(house / name)
    (folder / "traj_w_c.txt").symlink_to(house / "traj.txt")
    for number in (2, 10):
        color = cv2.imread(str(house / f"results/frame{number:06d}.jpg"))
        depth = cv2.imread(str(house / f"results/depth{number:06d}.png"), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(folder / f"rgb/rgb_{number}.png"), color)
        millimetres = np.round(depth / 6.5535).astype(np.uint16)
        cv2.imwrite(str(folder / f"depth/depth_{number}.png"), millimetres)
    camera = Camera.from_integer_centres(600, 340, 300.0, 300.0, 299.5, 169.5)
    source = ReplicaSemanticSource(folder, calibration=Calibration.registered(camera))
    assert len(source) == 2
    for index in range(2):
        frame = source.frame(index)
        assert frame.labels is not None
        assert frame.instances is not None
        for thing in np.unique(frame.instances[frame.instances > 0]):
            assert len(np.unique(frame.labels[frame.instances == thing])) == 1
