from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZipFile

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.record3d import Record3dSource
from recorders.reading import lzfse_decode
from recorders.registry import FORMATS
from recorders.room import RoomSource
from recorders.source import Source
from tests.round_trip import assert_round_trip
from tests.writers.record3d import lzfse, members_of, metadata_of, write_zip

SECONDS = ("0", "0.016666667", "0.0333333329", "0.05", "0.1", "0.125")
WIDTH, HEIGHT = 320, 240


@pytest.fixture(scope="module")
def members(room_frames: list[SensorFrame]) -> dict[str, bytes]:
    return members_of(room_frames)


@pytest.fixture
def metadata(room: RoomSource, room_frames: list[SensorFrame]) -> dict[str, Any]:
    return metadata_of(room_frames, room.calibration.color)


def test_round_trip(
    tmp_path: Path,
    room: RoomSource,
    room_frames: list[SensorFrame],
    members: dict[str, bytes],
    metadata: dict[str, Any],
    depth_agreement: Callable[[Source, SensorFrame, SensorFrame, float], float],
) -> None:
    source = Record3dSource(write_zip(tmp_path / "room.r3d", members, metadata))
    assert source.calibration == room.calibration
    log = assert_round_trip(source, room_frames, tmp_path / "room.mcap")
    assert log.stamps_ns() == [number * 10**9 // 60 for number in range(6)]
    assert depth_agreement(source, source.frame(0), source.frame(5), 0.05) > 0.9
    assert source.ground_truth_mesh() is None
    assert source.warnings == ()
    assert source.notes == {
        "images without a partner": "0",
        "frames without a pose": "0",
        "times": "60 a second",
        "depth left out": "of a confidence below 1",
    }


def test_either_order_of_k(
    tmp_path: Path, room: RoomSource, members: dict[str, bytes], metadata: dict[str, Any]
) -> None:
    k = np.array(metadata["K"], dtype=float).reshape(3, 3)
    metadata["K"] = k.T.ravel().tolist()
    source = Record3dSource(write_zip(tmp_path / "rows.r3d", members, metadata))
    assert source.calibration == room.calibration
    metadata["K"] = k.T.tolist()
    source = Record3dSource(write_zip(tmp_path / "nested.r3d", members, metadata))
    assert source.calibration == room.calibration


def test_each_frame_has_its_own_intrinsics(
    tmp_path: Path, room_frames: list[SensorFrame], metadata: dict[str, Any]
) -> None:
    small = [replace(frame, depth=frame.depth[::2, ::2]) for frame in room_frames]
    metadata |= {"dw": WIDTH // 2, "dh": HEIGHT // 2}
    coefficients = [[200.0 + i // 2, 201.0, 158.0 + i, 119.0] for i in range(6)]
    metadata["perFrameIntrinsicCoeffs"] = coefficients
    path = write_zip(tmp_path / "a.r3d", members_of(small), metadata)
    source = Record3dSource(path)
    assert source.calibration.color == Camera(WIDTH, HEIGHT, 200.0, 201.0, 158.0, 119.0)
    assert source.frame(0).calibration is None
    own = source.frame(3).calibration
    assert own is not None
    assert own.color == Camera(WIDTH, HEIGHT, 201.0, 201.0, 161.0, 119.0)
    # Scaled about the image's corner, from which Apple counts.
    assert own.depth == Camera(WIDTH // 2, HEIGHT // 2, 100.5, 100.5, 80.5, 59.5)
    log = assert_round_trip(source, small, tmp_path / "a.mcap")
    cameras = [(frame.calibration or log.calibration).color.cx for frame in log.frames()]
    assert cameras == [158.0, 159.0, 160.0, 161.0, 162.0, 163.0]
    given = Record3dSource(path, calibration=own)
    assert given.calibration is own
    assert given.frame(0).calibration is None


def test_times_are_exact(
    tmp_path: Path, members: dict[str, bytes], metadata: dict[str, Any]
) -> None:
    metadata["frameTimestamps"] = "TIMES"
    text = json.dumps(metadata).replace('"TIMES"', f"[{', '.join(SECONDS)}]")
    source = Record3dSource(write_zip(tmp_path / "a.r3d", members, text))
    stamps = [source.frame(i).stamp_ns for i in range(6)]
    assert stamps == [0, 16666667, 33333333, 50000000, 100000000, 125000000]
    assert source.notes["times"] == "frameTimestamps"


def test_frames_without_a_pose_or_partner_are_skipped(
    tmp_path: Path, room_frames: list[SensorFrame], members: dict[str, bytes], metadata: Any
) -> None:
    metadata["poses"][1] = [0] * 7
    metadata["poses"][2][5] = float("nan")
    members = {k: v for k, v in members.items() if k not in ("rgbd/4.depth", "rgbd/5.jpg")}
    source = Record3dSource(write_zip(tmp_path / "a.r3d", members, metadata))
    assert len(source) == 2
    assert source.notes["frames without a pose"] == "2"
    assert source.notes["images without a partner"] == "2"
    assert [source.frame(i).stamp_ns for i in (0, 1)] == [0, 3 * 10**9 // 60]
    assert source.frame(1).color == room_frames[3].color


def test_low_confidence_and_broken_numbers_are_not_depth(
    tmp_path: Path, room_frames: list[SensorFrame], members: dict[str, bytes], metadata: Any
) -> None:
    depth_m = room_frames[0].depth_m.astype("<f4").copy()
    depth_m[0, :4] = (np.nan, np.inf, -1.0, 1.5)
    confidence = np.full(depth_m.shape, 2, np.uint8)
    confidence[5], confidence[6] = 0, 1
    members = members | {
        "rgbd/0.depth": lzfse.compress(depth_m.tobytes()),
        "rgbd/0.conf": lzfse.compress(confidence.tobytes()),
    }
    path = write_zip(tmp_path / "a.r3d", members, metadata)
    for minimum, dropped in ((0, []), (1, [5]), (2, [5, 6])):
        found = Record3dSource(path, min_confidence=minimum).frame(0).depth
        wanted = depth_m.copy()
        wanted[0, :3] = 0
        wanted[dropped] = 0
        np.testing.assert_array_equal(found, wanted)
        assert found.dtype == np.float32
    del members["rgbd/0.conf"]
    without = Record3dSource(write_zip(tmp_path / "b.r3d", members, metadata))
    assert (without.frame(0).depth[5] > 0).any()
    with pytest.raises(ProgroundError, match="no confidence of 3"):
        Record3dSource(path, min_confidence=3)


def test_threads_in_any_order_read_the_same(
    tmp_path: Path, room_frames: list[SensorFrame], members: dict[str, bytes], metadata: Any
) -> None:
    source = Record3dSource(write_zip(tmp_path / "a.r3d", members, metadata))
    order = [int(i) for i in np.random.default_rng(0).integers(0, 6, 60)]
    with ThreadPoolExecutor(4) as executor:
        for index, frame in zip(order, executor.map(source.frame, order), strict=True):
            assert frame.color == room_frames[index].color
            np.testing.assert_array_equal(frame.depth, room_frames[index].depth_m)


def test_a_film_without_poses_is_warned_of(
    tmp_path: Path, members: dict[str, bytes], metadata: dict[str, Any]
) -> None:
    metadata["poses"] = [[0, 0, 0, 1, 0, 0, 0]] * 6
    source = Record3dSource(write_zip(tmp_path / "a.r3d", members, metadata))
    assert "every pose is the same" in source.warnings[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"w": None}, "no sizes w, h, dw and dh"),
        ({"w": 10**9}, "no sizes w, h, dw and dh"),
        ({"dh": 100}, "depth of 320x100 has not the shape of the colour image, 320x240"),
        ({"K": [1, 2]}, "K is not 9 numbers"),
        ({"K": [0] * 9}, "no intrinsics that are all above 0"),
        ({"perFrameIntrinsicCoeffs": [[]]}, "no intrinsics that are all above 0"),
        ({"perFrameIntrinsicCoeffs": [[1, 2, 3]]}, "perFrameIntrinsicCoeffs is not any x 4"),
        ({"poses": None}, "poses is not any x 7 numbers"),
        ({"poses": []}, "no frame has an image, depth and a pose"),
        ({"poses": [[0] * 7]}, "no frame has an image, depth and a pose"),
        ({"fps": 0}, "no times"),
        ({"fps": 59.94}, "no times"),
        ({"frameTimestamps": [0, 1, 1, 2, 3, 4]}, "frame 2 has no later time"),
        ({"frameTimestamps": ["x"] * 6}, "'x' is not a time in seconds"),
    ],
)
def test_broken_metadata_is_named(
    tmp_path: Path, members: dict[str, bytes], metadata: Any, change: Any, message: str
) -> None:
    path = write_zip(tmp_path / "a.r3d", members, metadata | change)
    with pytest.raises(ProgroundError, match=message) as caught:
        Record3dSource(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["{", "[]", "[" * 100_000, '{"w": 1e99999999999999999999}'])
def test_metadata_that_is_none_is_named(tmp_path: Path, text: str) -> None:
    with pytest.raises(ProgroundError, match=r"a\.r3d, metadata: (is not JSON|the metadata has)"):
        Record3dSource(write_zip(tmp_path / "a.r3d", {}, text))


@pytest.mark.parametrize(
    "name", ["/etc/passwd", "../up", "rgbd/../../up", "C:/windows", "..\\up", "\\\\host\\share"]
)
def test_names_that_lead_out_are_refused(
    tmp_path: Path, members: dict[str, bytes], metadata: Any, name: str
) -> None:
    path = write_zip(tmp_path / "a.r3d", members | {name: b"x"}, metadata)
    with pytest.raises(ProgroundError, match="leads out of the zip"):
        Record3dSource(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.r3d"]


def test_other_compressions_and_encryption_are_refused(
    tmp_path: Path, members: dict[str, bytes], metadata: dict[str, Any]
) -> None:
    path = write_zip(tmp_path / "a.r3d", members, metadata)
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 8] |= 1
    (tmp_path / "locked.r3d").write_bytes(data)
    with pytest.raises(ProgroundError, match="is encrypted"):
        Record3dSource(tmp_path / "locked.r3d")
    with ZipFile(path, "a") as archive:
        archive.writestr("x", b"y" * 1000, ZIP_BZIP2)
    with pytest.raises(ProgroundError, match="the file 'x' is compressed in a way"):
        Record3dSource(path)


def test_bombs_are_refused_unopened(
    tmp_path: Path, members: dict[str, bytes], metadata: dict[str, Any]
) -> None:
    path = tmp_path / "a.r3d"
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for name, data in (members | {"rgbd/0.jpg": bytes(65 * 2**20)}).items():
            archive.writestr(name, data)
        archive.writestr("metadata", json.dumps(metadata))
    with pytest.raises(ProgroundError, match=r"rgbd/0\.jpg: claims 68157440 bytes"):
        Record3dSource(path).frame(0)
    bomb = lzfse.compress(bytes(2 * 10**6))
    for data in (bomb, b"", b"bvx2", bomb[:100], members["rgbd/0.depth"][:-20], bytes(2000)):
        write_zip(path, members | {"rgbd/0.depth": data}, metadata)
        with pytest.raises(ProgroundError, match=r"rgbd/0\.depth: does not hold 307200 bytes"):
            Record3dSource(path).frame(0)


def test_a_broken_image_is_named(
    tmp_path: Path, room_frames: list[SensorFrame], members: dict[str, bytes], metadata: Any
) -> None:
    small = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    for data, message in (
        (room_frames[0].color[:-9], "cut short"),
        (b"no image", "is not a readable image"),
        (small, "is 8x8, but the calibration is for 320x240"),
    ):
        path = write_zip(tmp_path / "a.r3d", members | {"rgbd/0.jpg": data}, metadata)
        with pytest.raises(ProgroundError, match=rf"a\.r3d, rgbd/0\.jpg: .*{message}"):
            Record3dSource(path).frame(0)


def test_no_zip_and_no_file(tmp_path: Path) -> None:
    (tmp_path / "a.r3d").write_bytes(b"PK\x03\x04 and nothing else")
    with pytest.raises(ProgroundError, match="is not a whole zip file"):
        Record3dSource(tmp_path / "a.r3d")
    with pytest.raises(ProgroundError, match=r"b\.r3d: no such file"):
        Record3dSource(tmp_path / "b.r3d")
    with ZipFile(tmp_path / "c.r3d", "w"):
        pass
    with pytest.raises(ProgroundError, match="metadata: no such file in the zip"):
        Record3dSource(tmp_path / "c.r3d")


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    lzfse_decode._decoder.cache_clear()
    monkeypatch.setattr(lzfse_decode, "find_spec", lambda _: None)
    with pytest.raises(ProgroundError, match=r"pip install 'proground-log\[phone\]'"):
        lzfse_decode.decompress(b"", 1, where="a")
    lzfse_decode._decoder.cache_clear()


def test_recognise(tmp_path: Path, members: dict[str, bytes], metadata: dict[str, Any]) -> None:
    path = write_zip(tmp_path / "a.R3D", members, metadata)
    assert FORMATS["record3d"].recognise(path) == "is a .r3d file"
    path.with_name("red.r3d").write_bytes(b"\x00\x00\x02\x00RED2")
    assert FORMATS["record3d"].recognise(tmp_path / "red.r3d") is None
    path.rename(tmp_path / "a.zip")
    assert FORMATS["record3d"].recognise(tmp_path / "a.zip") is None
    assert FORMATS["record3d"].recognise(tmp_path) is None
    assert FORMATS["record3d"].recognise(tmp_path / "missing.r3d") is None
    assert FORMATS["record3d"].recognise(Path("a\0b.r3d")) is None


def test_mutations_are_errors_or_change_nothing_unseen(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    frames = [
        SensorFrame(
            i,
            i,
            i,
            cv2.imencode(".jpg", rng.integers(0, 255, (24, 32, 3), np.uint8))[1].tobytes(),
            "jpeg",
            rng.integers(0, 4000, (24, 32), dtype=np.uint16),
            np.eye(4),
        )
        for i in range(2)
    ]
    camera = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)
    path = write_zip(tmp_path / "a.r3d", members_of(frames), metadata_of(frames, camera))
    whole = path.read_bytes()
    refused = []
    for _ in range(300):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] ^= 1 << rng.integers(0, 8)
        path.write_bytes(data[: rng.integers(0, len(data))] if rng.random() < 0.2 else data)
        try:
            source = Record3dSource(path, calibration=Calibration.registered(camera))
            for index in range(len(source)):
                # The zip's checksums leave nothing else.
                frame = source.frame(index)
                assert frame.color in (frames[0].color, frames[1].color)
                assert any(np.array_equal(frame.depth, f.depth_m) for f in frames)
        except ProgroundError as error:
            refused.append(error.where)
    assert len(refused) > 200
    assert all(where.startswith(str(path)) for where in refused)
