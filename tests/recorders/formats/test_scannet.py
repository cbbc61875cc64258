from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.frame import SensorFrame
from recorders.formats.scannet import NYU40, ScannetSource, recognise
from recorders.room import RoomSource
from tests.recorders.formats.test_scannet_sens import LOST, intrinsic_of
from tests.round_trip import assert_round_trip

COLUMNS = ("id", "raw_category", "category", "count", "nyu40id", "eigen13id", "nyuClass")
STEP = 5
"""Exports often leave frames out."""


def text_of(matrix: np.ndarray) -> str:
    """As NumPy's savetxt with %f, which is what SensReader uses."""
    return "".join(" ".join(f"{x:f}" for x in row) + "\n" for row in matrix)


def labels_ply() -> bytes:
    """Three vertices as in *_vh_clean_2.labels.ply: with alpha, and NYU40's labels."""
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nproperty uchar alpha\nproperty ushort label\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    kinds = [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in "rgba"), ("label", "<u2")]
    vertices = np.zeros(3, np.dtype(kinds))
    vertices["x"], vertices["label"] = (1, 2, 3), (5, 0, 39)
    return header.encode() + vertices.tobytes() + b"\3" + np.arange(3, dtype="<i4").tobytes()


def write_scene(
    scene: Path, room: RoomSource, frames: Sequence[SensorFrame], *, truth: bool = True
) -> Path:
    """Write frames of the room as SensReader and the data set's archives lay them out."""
    folders = ("color", "depth", "pose", "intrinsic")
    for name in (*folders, "label-filt", "instance-filt") if truth else folders:
        (scene / name).mkdir(parents=True)
    for name in ("color", "depth"):
        camera = getattr(room.calibration, name)
        (scene / f"intrinsic/intrinsic_{name}.txt").write_text(text_of(intrinsic_of(camera)))
        (scene / f"intrinsic/extrinsic_{name}.txt").write_text(text_of(np.eye(4)))
    for index, frame in enumerate(frames):
        number = index * STEP
        (scene / f"color/{number}.jpg").write_bytes(frame.color)
        cv2.imwrite(str(scene / f"depth/{number}.png"), frame.depth)
        (scene / f"pose/{number}.txt").write_text(text_of(frame.world_from_camera))
        if truth:
            assert frame.labels is not None
            assert frame.instances is not None
            instances = frame.instances.astype(np.uint8)
            cv2.imwrite(str(scene / f"label-filt/{number}.png"), frame.labels)
            cv2.imwrite(str(scene / f"instance-filt/{number}.png"), instances)
    if truth:
        (scene / "scene0000_00_vh_clean_2.labels.ply").write_bytes(labels_ply())
    (scene / "scene0000_00_vh_clean_2.ply").write_bytes(b"ply\nwithout labels")
    return scene


def true_names(room: RoomSource) -> dict[int, str]:
    """The room's classes, without "nothing"."""
    return {label: name for label, name in room.label_names.items() if label > 0}


def write_label_table(folder: Path, names: dict[int, str]) -> Path:
    """A table where class n is class n % 40 + 1 of NYU40, but for one that has none."""
    rows = [
        [str(label), name, name, "9", str(label % 40 + 1) if label != 2 else "", "1", name]
        for label, name in names.items()
    ]
    path = folder / "scannetv2-labels.combined.tsv"
    path.write_text("".join("\t".join(row) + "\n" for row in [COLUMNS, *rows]))
    return path


def with_things(frames: Sequence[SensorFrame]) -> list[SensorFrame]:
    """The frames, each class in the left half a thing of its own, and each in the right half."""
    found = []
    for frame in frames:
        assert frame.labels is not None
        is_right = np.arange(frame.labels.shape[1]) >= frame.labels.shape[1] // 2
        things = np.where(frame.labels > 0, 2 * frame.labels + is_right, 0)
        found.append(replace(frame, instances=things.astype(np.uint16)))
    return found


@pytest.fixture
def frames(room_frames: list[SensorFrame]) -> list[SensorFrame]:
    return with_things(room_frames)


@pytest.fixture
def scene(tmp_path: Path, room: RoomSource, frames: list[SensorFrame]) -> Path:
    """A scene with the table of labels two folders above."""
    write_label_table(tmp_path, true_names(room))
    return write_scene(tmp_path / "scans/scene0000_00", room, frames)


def test_the_room_comes_back(
    scene: Path, tmp_path: Path, room: RoomSource, frames: list[SensorFrame]
) -> None:
    source = ScannetSource(scene)
    assert recognise(scene) == "has color, depth, pose and intrinsic/intrinsic_depth.txt"
    camera, put = source.calibration.depth, room.calibration.depth
    assert (camera.width, camera.height) == (put.width, put.height)
    assert [camera.fx, camera.cx] == pytest.approx([put.fx, put.cx], abs=1e-6)
    assert source.label_names == true_names(room)
    # Numbers, not names, say the order: 5 comes before 10.
    assert [source.frame(i).stamp_ns for i in range(3)] == [0, 5 * 10**9 // 30, 10**10 // 30]
    assert source.frame(0).depth.dtype == np.uint16
    reader = assert_round_trip(source, frames, tmp_path / "room.mcap")
    found = next(iter(reader.frames()))
    assert found.labels is not None
    assert found.instances is not None
    assert reader.label_names == true_names(room)


def test_without_ground_truth(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    scene = write_scene(tmp_path / "scene", room, room_frames, truth=False)
    for name in ("color", "depth"):
        (scene / f"intrinsic/extrinsic_{name}.txt").unlink()
    source = ScannetSource(scene)
    assert source.label_names == {}
    assert source.ground_truth_mesh() == b"ply\nwithout labels"
    np.testing.assert_array_equal(source.calibration.depth_from_color, np.eye(4))
    assert_round_trip(source, room_frames, tmp_path / "room.mcap")


def test_label_sets_and_the_mesh(scene: Path, room_frames: list[SensorFrame]) -> None:
    assert room_frames[0].labels is not None
    nyu40_names = dict(enumerate(NYU40, start=1))
    assert (nyu40_names[1], nyu40_names[5], nyu40_names[40]) == ("wall", "chair", "otherprop")
    # The mesh has NYU40's classes: with ScanNet's in the images, it would mislead.
    own = ScannetSource(scene)
    assert own.ground_truth_mesh() is None
    assert "scannet-to-nyu40" in own.notes["true mesh"]
    as_is = ScannetSource(scene, label_set="nyu40")
    converted = ScannetSource(scene, label_set="scannet-to-nyu40")
    for source in (as_is, converted):
        assert source.label_names == nyu40_names
        mesh = source.ground_truth_mesh()
        assert mesh is not None
        vertices_m, labels, _ = read_labelled_mesh(mesh, where="mesh")
        np.testing.assert_array_equal(vertices_m[:, 0], [1, 2, 3])
        np.testing.assert_array_equal(labels, [5, 0, 39])
    put = room_frames[0].labels
    np.testing.assert_array_equal(as_is.frame(0).labels, put)
    wanted = np.where(np.isin(put, [0, 2]), 0, put % 40 + 1)
    found = converted.frame(0).labels
    assert found is not None
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, wanted)
    with pytest.raises(ProgroundError, match=r"label set 'coco'; choose one of scannet, nyu40"):
        ScannetSource(scene, label_set="coco")


def test_a_mesh_alone_has_its_names(scene: Path) -> None:
    for name in ("label-filt", "instance-filt"):
        (scene / name).rename(scene / f"{name}.away")
    source = ScannetSource(scene)
    assert source.label_names[40] == "otherprop"
    assert source.ground_truth_mesh() == labels_ply()
    assert source.frame(0).labels is None


@pytest.mark.parametrize("lost", [LOST, np.full((4, 4), np.nan), np.zeros((4, 4))])
def test_frames_that_lost_tracking_are_left_out(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame], lost: np.ndarray
) -> None:
    frames = list(room_frames)
    frames[0] = replace(frames[0], world_from_camera=lost)
    source = ScannetSource(write_scene(tmp_path / "scene", room, frames, truth=False))
    assert source.notes == {"frames without a pose": "1"}
    assert source.frame(0).stamp_ns == STEP * 10**9 // 30
    assert_round_trip(source, frames[1:], tmp_path / "room.mcap")


def test_without_any_pose(tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]) -> None:
    lost = [replace(frame, world_from_camera=LOST) for frame in room_frames]
    scene = write_scene(tmp_path / "scene", room, lost, truth=False)
    with pytest.raises(ProgroundError, match=r"pose: none of the 6 frames has a pose"):
        ScannetSource(scene)


def test_images_of_another_size_than_the_intrinsics(scene: Path, room: RoomSource) -> None:
    path = scene / "intrinsic/intrinsic_color.txt"
    matrix = intrinsic_of(room.calibration.color)
    matrix[:2] *= 2
    path.write_text(text_of(matrix))
    with pytest.raises(ProgroundError, match=r"intrinsic_color\.txt: has the intrinsics .* images"):
        ScannetSource(scene)
    own = Calibration.registered(room.calibration.depth)
    assert ScannetSource(scene, calibration=own).calibration == own


def test_extrinsics_are_taken(scene: Path) -> None:
    base_from_depth = np.eye(4)
    base_from_depth[0, 3] = 0.025
    (scene / "intrinsic/extrinsic_depth.txt").write_text(text_of(base_from_depth))
    found = ScannetSource(scene).calibration.depth_from_color
    np.testing.assert_allclose(found[:3, 3], [-0.025, 0, 0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("pose/10.txt", None, "is missing, though the frame has depth"),
        ("color/10.jpg", None, "is missing, though the frame has depth"),
        ("label-filt/10.png", None, "is missing, though the frame has depth"),
        ("instance-filt/10.png", None, "is missing, though the frame has depth"),
        ("intrinsic/intrinsic_color.txt", None, "no such file"),
        ("intrinsic/intrinsic_depth.txt", "1 2 3", "16 numbers"),
        ("intrinsic/extrinsic_depth.txt", "2 " * 16, "not rigid"),
        ("pose/10.txt", "1 0 0", "16 numbers"),
        ("pose/10.txt", "2 " * 16, "not rigid"),
        ("color/0.jpg", "text", "not a readable image"),
        ("../../scannetv2-labels.combined.tsv", "id\tname\n1\tx\n", "does not name the classes"),
        (
            "../../scannetv2-labels.combined.tsv",
            "id\traw_category\tnyu40id\n1\tx\t41\n",
            "classes 1",
        ),
    ],
)
def test_what_is_wrong_is_found_on_opening(
    scene: Path, name: str, content: str | None, message: str
) -> None:
    path = (scene / name).resolve()
    path.unlink()
    if content is not None:
        path.write_text(content)
    with pytest.raises(ProgroundError, match=message) as caught:
        ScannetSource(scene)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "name", ["color/10.jpg", "depth/10.png", "label-filt/10.png", "instance-filt/10.png"]
)
def test_a_truncated_image_is_named(scene: Path, name: str) -> None:
    (scene / name).write_bytes((scene / name).read_bytes()[:-9])
    with pytest.raises(ProgroundError, match=name):
        ScannetSource(scene).frame(2)


def test_classes_without_the_table(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "scannetv2-labels.combined.tsv").unlink()
    with pytest.raises(ProgroundError, match=r"scene0000_00: has no scannetv2-labels\.combined"):
        ScannetSource(scene)
    assert ScannetSource(scene, label_set="nyu40").label_names[2] == "floor"


def test_other_paths_are_not_recognised(tmp_path: Path, scene: Path) -> None:
    (scene / "intrinsic/intrinsic_depth.txt").unlink()
    (tmp_path / "file").write_text("x")
    for path in (scene, tmp_path, tmp_path / "file", tmp_path / "none", tmp_path / "nul\0"):
        assert recognise(path) is None
    with pytest.raises(ProgroundError, match="depth: no such folder"):
        ScannetSource(tmp_path)
