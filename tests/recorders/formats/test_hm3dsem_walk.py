from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.hm3dsem_walk import Hm3dsemWalkSource, recognise
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.hm3dsem_walk import SCENE, write_walk
from tests.writers.scannet import with_things


def category_of(frames: Sequence[SensorFrame], room: RoomSource) -> dict[int, str]:
    """The class's name of each thing that the frames show."""
    things = np.unique(
        np.stack([frame.instances for frame in frames if frame.instances is not None])
    )
    return {int(thing): room.label_names[int(thing) // 2] for thing in things if thing}


def write_names(path: Path, names: dict[int, str]) -> Path:
    lines = [f'{thing},{thing:06X},"{name}",{thing % 3}\n' for thing, name in names.items()]
    path.write_text("HM3D Semantic Annotations\n" + "".join(lines))
    return path


@pytest.fixture
def frames(room_frames: list[SensorFrame]) -> list[SensorFrame]:
    return with_things(room_frames)


@pytest.fixture
def walk(tmp_path: Path, room: RoomSource, frames: list[SensorFrame]) -> Path:
    """A walk with the classes' names in the folder above."""
    write_names(tmp_path / f"{SCENE}.semantic.txt", category_of(frames, room))
    return write_walk(tmp_path / f"00824-{SCENE}", frames)


def test_the_room_comes_back(
    walk: Path, tmp_path: Path, room: RoomSource, frames: list[SensorFrame]
) -> None:
    source = Hm3dsemWalkSource(walk, calibration=room.calibration)
    assert recognise(walk) == "has rgb, depth and pose with files <scene>_<number>"
    names = category_of(frames, room)
    # Classes are numbered by the alphabet: what was put in is compared by name.
    number = {name: label for label, name in source.label_names.items()}
    assert list(source.label_names.values()) == sorted(set(names.values()))
    label_of = np.zeros(65536, np.uint16)
    for thing, name in names.items():
        label_of[thing] = number[name]
    expected = []
    for frame in frames:
        assert frame.instances is not None
        expected.append(replace(frame, labels=label_of[frame.instances]))
    assert (expected[0].labels > 0).mean() > 0.5  # type: ignore[operator]
    reader = assert_round_trip(source, expected, tmp_path / "walk.mcap", same_bytes=False)
    found = next(iter(reader.frames()))
    assert found.labels is not None
    assert found.instances is not None
    assert source.frame(0).color == (walk / f"rgb/{SCENE}_000000.png").read_bytes()
    assert source.frame(0).depth.dtype == np.uint16
    assert source.frame(3).stamp_ns == 3 * 10**9 // 5
    assert source.notes == {"frames without a pose": "0"}
    assert source.ground_truth_mesh() is None


def test_the_camera_sees_90_degrees(walk: Path, room: RoomSource) -> None:
    calibration = Hm3dsemWalkSource(walk).calibration
    width, height = room.calibration.color.width, room.calibration.color.height
    focal = width / 2
    assert calibration == Calibration.registered(
        Camera(width, height, focal, focal, width / 2, height / 2)
    )
    middle_row = calibration.depth.directions[height // 2]
    edges = middle_row[[0, -1], 0] + np.array([-0.5, 0.5]) / focal
    np.testing.assert_allclose(np.degrees(np.arctan(edges)), [-45, 45], atol=1e-4)


def test_without_names_or_things(walk: Path, tmp_path: Path, frames: list[SensorFrame]) -> None:
    (tmp_path / f"{SCENE}.semantic.txt").unlink()
    source = Hm3dsemWalkSource(walk)
    assert source.label_names == {}
    assert source.notes["true classes"] == f"none: there is no {SCENE}.semantic.txt here or above"
    frame = source.frame(1)
    assert frame.labels is None
    np.testing.assert_array_equal(frame.instances, frames[1].instances)
    bare = Hm3dsemWalkSource(write_walk(tmp_path / "bare", frames, truth=False))
    assert bare.notes["true classes"] == "none: there is no folder semantic"
    assert bare.frame(0).instances is None


def test_a_frame_without_a_pose_is_left_out(walk: Path) -> None:
    (walk / f"pose/{SCENE}_000001.txt").write_text("nan\t" * 16)
    source = Hm3dsemWalkSource(walk)
    assert source.notes["frames without a pose"] == "1"
    assert [source.frame(i).stamp_ns for i in range(2)] == [0, 2 * 10**9 // 5]
    for path in (walk / "pose").iterdir():
        path.write_text("inf\t" * 16)
    with pytest.raises(ProgroundError, match=r"depth: none of the 6 frames has a pose"):
        Hm3dsemWalkSource(walk)


NAMES = f"../{SCENE}.semantic.txt"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (f"rgb/{SCENE}_000002.png", None, "is missing, though the frame has depth"),
        (f"pose/{SCENE}_000002.txt", None, "is missing, though the frame has depth"),
        (f"semantic/{SCENE}_000002.npy", None, "is missing, though the frame has depth"),
        (f"pose/{SCENE}_000002.txt", "1 2 3 0 0 0 1", "16 numbers"),
        (f"pose/{SCENE}_000002.txt", "2 " * 16, "not rigid"),
        (f"rgb/{SCENE}_000000.png", "text", "not a readable image"),
        (NAMES, "", "does not begin with 'HM3D Semantic Annotations'"),
        (NAMES, 'HM3D Semantic Annotations\n1,FF0000,"wall",0\n2,FF', r"txt:3: is not number"),
        (NAMES, 'HM3D Semantic Annotations\n99999,FF0000,"wall",0\n', r"txt:2: is not number"),
        (NAMES, "HM3D Semantic Annotations\n\n", r"txt:2: is not number"),
    ],
)
def test_what_is_wrong_is_found_on_opening(
    walk: Path, name: str, content: str | None, message: str
) -> None:
    path = (walk / name).resolve()
    path.unlink()
    if content is not None:
        path.write_text(content)
    with pytest.raises(ProgroundError, match=message) as caught:
        Hm3dsemWalkSource(walk)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("folder", ["rgb", "depth", "semantic"])
def test_a_truncated_image_is_named(walk: Path, folder: str) -> None:
    (path,) = (walk / folder).glob("*_000002.*")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ProgroundError, match=path.name):
        Hm3dsemWalkSource(walk).frame(2)


@pytest.mark.parametrize(
    ("things", "message"),
    [
        (np.full((120, 160), 65536, np.uint32), "no whole numbers from 0 to 65535"),
        (np.full((120, 160), -1, np.int16), "no whole numbers"),
        (np.full((120, 160), 1.5), "no whole numbers"),
        (np.full((120, 160), np.nan), "no whole numbers"),
        (np.zeros((120, 16), np.uint32), "is 16x120, but the calibration is for 160x120"),
        (np.zeros((120, 160, 3), np.uint8), "one number a pixel"),
        (np.array([{"pickled": 1}]), "one number a pixel"),
    ],
)
def test_images_of_things_that_are_none(walk: Path, things: np.ndarray, message: str) -> None:
    size = Camera(160, 120, 80.0, 80.0, 80.0, 60.0)
    for path in (walk / "rgb").iterdir():
        cv2.imwrite(str(path), np.zeros((120, 160, 3), np.uint8))
    path = walk / f"semantic/{SCENE}_000000.npy"
    np.save(path, things)
    source = Hm3dsemWalkSource(walk)
    assert source.calibration.color == size
    with pytest.raises(ProgroundError, match=message) as caught:
        source.frame(0)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("kind", [np.uint8, np.int32, ">u4", np.int64])
def test_every_kind_of_whole_number_is_read(
    walk: Path, frames: list[SensorFrame], kind: type
) -> None:
    put = frames[0].instances
    assert put is not None
    np.save(walk / f"semantic/{SCENE}_000000.npy", put.astype(kind))
    np.testing.assert_array_equal(Hm3dsemWalkSource(walk).frame(0).instances, put)


def test_other_paths_are_not_recognised(tmp_path: Path, walk: Path) -> None:
    assert recognise(tmp_path) is None
    assert recognise(tmp_path / "none") is None
    assert recognise(walk / f"rgb/{SCENE}_000000.png") is None
    for path in (walk / "pose").iterdir():
        path.rename(path.with_name(path.name.replace(SCENE, "frame")))
    assert recognise(walk) is None
    with pytest.raises(ProgroundError, match="pose: no such folder"):
        Hm3dsemWalkSource(tmp_path)
