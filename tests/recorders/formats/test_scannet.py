from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.frame import SensorFrame
from recorders.formats.scannet import NYU40, ScannetSource, recognise
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.scannet import (
    STEP,
    labels_ply,
    text_of,
    true_names,
    with_things,
    write_label_table,
    write_scene,
)
from tests.writers.scannet_sens import LOST, intrinsic_of


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
    with pytest.raises(ProgroundError, match=r"depth: none of the 6 frames has a pose"):
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
    with pytest.raises(ProgroundError, match="pose: no such folder"):
        ScannetSource(tmp_path)
