from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.colmap.model import read_model
from recorders.formats.colmap.source import ColmapSource, recognise
from recorders.formats.seven_scenes import kinect_calibration
from recorders.reading.association import parse_pose
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.colmap import (
    METRES_PER_UNIT,
    NAMES,
    NUMBERS,
    write_binary,
    write_depth_maps,
    write_text,
    write_workspace,
)

LENS = (0.02, -0.01, 0.001, -0.002)


@pytest.fixture
def workspace(tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame]) -> Path:
    return write_workspace(tmp_path, room_frames, room.calibration.color)


@pytest.mark.parametrize("layout", ["binary", "text"])
def test_pycolmap_reads_the_fixture_and_the_same_in_it(
    tmp_path: Path, room: RoomSource, room_frames: list[SensorFrame], layout: str
) -> None:
    camera = replace(room.calibration.color, distortion=(*LENS, 0.0))
    write = write_binary if layout == "binary" else write_text
    write(tmp_path / "model", room_frames, camera)
    theirs = pycolmap.Reconstruction(str(tmp_path / "model"))
    ours = read_model(tmp_path / "model")
    assert len(ours) == theirs.num_reg_images() == 6
    for image in ours:
        other = theirs.find_image_with_name(image.name)
        assert other is not None
        pose = other.cam_from_world().matrix()
        np.testing.assert_allclose(image.camera_from_world[:3], pose, atol=1e-12)
        seen = [p for p in other.points2D if p.has_point3D()]
        np.testing.assert_array_equal(image.pixels, [p.xy for p in seen])
        world = np.array([theirs.points3D[p.point3D_id].xyz for p in seen])
        np.testing.assert_allclose(image.points, world @ pose[:, :3].T + pose[:, 3], atol=1e-9)
        assert image.camera == camera
        # Both lenses see the points where the fixture put them.
        np.testing.assert_allclose(camera.project(image.points), image.pixels, atol=1e-6)
        pixels = theirs.cameras[3].img_from_cam(image.points)
        np.testing.assert_allclose(pixels, image.pixels, atol=1e-4)


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_poses_of_rigs(tmp_path: Path, suffix: str) -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.num_cameras_per_rig, options.num_rigs, options.num_frames_per_rig = 2, 2, 3
    options.num_points3D, options.sensor_from_rig_translation_stddev = 20, 0.2
    pycolmap.set_random_seed(3)
    theirs = pycolmap.synthesize_dataset(options)
    (theirs.write_binary if suffix == ".bin" else theirs.write_text)(str(tmp_path))
    assert (tmp_path / f"rigs{suffix}").is_file()
    ours = read_model(tmp_path)
    assert len(ours) == 12
    for image in ours:
        other = theirs.find_image_with_name(image.name)
        assert other is not None
        pose = other.cam_from_world().matrix()
        np.testing.assert_allclose(image.camera_from_world[:3], pose, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("SIMPLE_RADIAL", [90.0, 50.0, 40.0, -0.1]),
        ("FULL_OPENCV", [90.0, 91.0, 50.0, 40.0, -0.1, 0.02, 0.003, -0.004, 0.01, 0.1, 0.02, 0.03]),
        ("FISHEYE", [90.0, 91.0, 50.0, 40.0]),
        ("FOV", [90.0, 91.0, 50.0, 40.0, 0.7]),
    ],
)
def test_lenses_project_as_colmap_does(tmp_path: Path, name: str, params: list[float]) -> None:
    theirs, camera = one_camera(name, params)
    points = np.random.default_rng(0).uniform((-0.8, -0.6, 2), (0.8, 0.6, 4), (50, 3))
    for suffix in (".bin", ".txt"):
        folder = tmp_path / suffix
        folder.mkdir()
        (theirs.write_binary if suffix == ".bin" else theirs.write_text)(str(folder))
        ours = read_model(folder)[0]
        atol = 0.01 if ours.lens else 1e-6
        assert ours.lens == ("FOV, as OpenCV's fisheye within 0.01 px" if name == "FOV" else "")
        pixels = ours.camera.project(points)
        np.testing.assert_allclose(pixels, camera.img_from_cam(points), atol=atol)


def test_panoramas_are_refused(tmp_path: Path) -> None:
    theirs, _ = one_camera("EQUIRECTANGULAR", [100.0, 80.0])
    for suffix in (".bin", ".txt"):
        folder = tmp_path / suffix
        folder.mkdir()
        (theirs.write_binary if suffix == ".bin" else theirs.write_text)(str(folder))
        with pytest.raises(ProgroundError, match=rf"cameras\{suffix}.* EQUIRECTANGULAR is of pan"):
            read_model(folder)


def one_camera(name: str, params: list[float]) -> tuple[pycolmap.Reconstruction, pycolmap.Camera]:
    """A model of one image that sees nothing, and its camera."""
    theirs = pycolmap.Reconstruction()
    camera = pycolmap.Camera(camera_id=1, model=name, width=100, height=80, params=params)
    theirs.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="a.jpg", camera_id=1, image_id=1)
    theirs.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    return theirs, camera


def test_a_fitted_lens_is_noted(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    color = room.calibration.color
    shutil.rmtree(workspace / "sparse/0")
    write_text(workspace / "sparse/0", room_frames, color)
    assert "lens" not in ColmapSource(workspace).notes
    path = workspace / "sparse/0/cameras.txt"
    params = f"{color.fx} {color.fy} {color.cx} {color.cy} 0.6"
    path.write_text(f"3 FOV {color.width} {color.height} {params}\n")
    source = ColmapSource(workspace, depth=workspace / "sensor", scale=METRES_PER_UNIT)
    assert source.notes["lens"] == "FOV, as OpenCV's fisheye within 0.01 px"
    log = assert_round_trip(source, room_frames, workspace / "log.mcap")
    assert log.calibration.color.is_fisheye


def test_depth_maps_round_trip(workspace: Path, room_frames: list[SensorFrame]) -> None:
    write_depth_maps(workspace, room_frames, "photometric", factor=3.0)
    write_depth_maps(workspace, room_frames, "geometric")
    (workspace / "images/frame-5.jpg").write_bytes(room_frames[0].color)
    source = ColmapSource(workspace, scale=METRES_PER_UNIT)
    assert_round_trip(source, room_frames, workspace / "log.mcap", depth_atol_m=1e-6)
    assert [source.frame(i).stamp_ns for i in range(6)] == [n * 10**9 // 30 for n in NUMBERS]
    assert source.notes == {
        "depth": "geometric depth maps",
        "times": "30 Hz, by the numbers in the names",
        "frames without a pose": "1",
        "frames without depth": "0",
        "scale": "0.25 m a unit, as given",
    }
    assert source.warnings == ()
    assert source.calibration.is_registered
    assert source.ground_truth_mesh() is None
    assert source.label_names == {}


def test_photometric_maps_will_do_and_images_without_one_are_counted(
    workspace: Path, room_frames: list[SensorFrame]
) -> None:
    write_depth_maps(workspace, room_frames, "photometric")
    (workspace / f"stereo/depth_maps/{NAMES[2]}.photometric.bin").unlink()
    source = ColmapSource(workspace)
    assert len(source) == 5
    assert source.notes["depth"] == "photometric depth maps"
    assert source.notes["frames without depth"] == "1"
    assert source.notes["scale"] == "unknown, one unit is taken for a metre"
    assert ["no scale" in warning for warning in source.warnings] == [True]
    expected = room_frames[0].depth_m / np.float32(METRES_PER_UNIT)
    np.testing.assert_allclose(source.frame(0).depth, expected, rtol=1e-6)
    centre = room_frames[0].world_from_camera[:3, 3] / METRES_PER_UNIT
    np.testing.assert_allclose(source.frame(0).world_from_camera[:3, 3], centre, atol=1e-9)


def test_smaller_depth_maps_have_a_smaller_camera(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    halves = [replace(frame, depth=frame.depth[::2, ::2].copy()) for frame in room_frames]
    write_depth_maps(workspace, halves, "geometric")
    source = ColmapSource(workspace, scale=METRES_PER_UNIT)
    color, depth = source.calibration.color, source.calibration.depth
    assert color == room.calibration.color
    assert (depth.width, depth.height) == (color.width // 2, color.height // 2)
    assert (depth.fx, depth.cx, depth.cy) == (color.fx / 2, color.cx / 2, color.cy / 2)
    np.testing.assert_array_equal(source.calibration.depth_from_color, np.eye(4))
    assert source.frame(1).depth.shape == (depth.height, depth.width)


def test_sensor_depth_round_trip_finds_the_scale(
    workspace: Path, room_frames: list[SensorFrame]
) -> None:
    source = ColmapSource(workspace, depth=workspace / "sensor")
    fitted = float(source.notes["scale"].split()[0])
    assert fitted == pytest.approx(METRES_PER_UNIT, rel=1e-3)
    assert "track points against depth, residual" in source.notes["scale"]
    assert source.notes["depth"] == "images of a sensor"
    assert source.warnings == ()
    given = ColmapSource(workspace, depth=workspace / "sensor", scale=METRES_PER_UNIT)
    assert_round_trip(given, room_frames, workspace / "log.mcap")
    assert given.frame(0).depth.dtype == np.uint16


def test_a_depth_camera_beside_the_colour_camera(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    mount = np.eye(4)
    mount[:3, 3] = (0.1, 0.0, 0.02)
    depth_camera = replace(room.calibration.depth, fx=77.0)
    rig = Calibration(Camera(9, 9, 1.0, 1.0, 1.0, 1.0), depth_camera, mount)
    source = ColmapSource(
        workspace, depth=workspace / "sensor", calibration=rig, scale=METRES_PER_UNIT
    )
    assert source.calibration == Calibration(room.calibration.color, depth_camera, mount)
    for index, frame in enumerate(room_frames):
        expected = frame.world_from_camera @ np.linalg.inv(mount)
        np.testing.assert_allclose(source.frame(index).world_from_camera, expected, atol=1e-9)


def test_depth_of_other_images_is_warned_of(
    workspace: Path, room_frames: list[SensorFrame]
) -> None:
    depth = np.random.default_rng(0).integers(500, 5000, room_frames[0].depth.shape)
    for path in (workspace / "sensor").iterdir():
        cv2.imwrite(str(path), depth.astype(np.uint16))
    source = ColmapSource(workspace, depth=workspace / "sensor")
    assert ["fits poorly" in warning for warning in source.warnings] == [True]


def test_65535_is_no_depth(workspace: Path, room_frames: list[SensorFrame]) -> None:
    depth = room_frames[0].depth.copy()
    depth[:3] = 65535
    cv2.imwrite(str(workspace / "sensor/0000-depth.png"), depth)
    source = ColmapSource(workspace, depth=workspace / "sensor")
    assert not source.frame(0).depth[:3].any()
    np.testing.assert_array_equal(source.frame(0).depth[3:], depth[3:])


def test_depth_images_of_the_same_name(workspace: Path, room_frames: list[SensorFrame]) -> None:
    for name, frame in list(zip(NAMES, room_frames, strict=True))[:5]:
        path = (workspace / "sensor" / name).with_suffix(".png")
        cv2.imwrite(str(path), frame.depth)
    cv2.imwrite(str(workspace / "sensor/another-0000-depth.png"), room_frames[3].depth)
    source = ColmapSource(workspace, depth=workspace / "sensor")
    assert len(source) == 5
    np.testing.assert_array_equal(source.frame(4).depth, room_frames[4].depth)


def test_points_alone(workspace: Path, room_frames: list[SensorFrame]) -> None:
    source = ColmapSource(workspace, scale=METRES_PER_UNIT)
    assert source.notes["depth"] == "the model's points only"
    assert ["no depth maps" in warning for warning in source.warnings] == [True]
    for index, frame in enumerate(room_frames):
        depth = source.frame(index).depth
        assert depth.dtype == np.float32
        assert 40 < np.count_nonzero(depth) <= 60
        np.testing.assert_allclose(depth[depth > 0], frame.depth_m[depth > 0], rtol=1e-5)


def test_of_points_in_one_pixel_the_nearest_counts(workspace: Path) -> None:
    write = workspace / "sparse/0"
    lines = ["1 1 0 0 0 0 0 0 3 frame-0.jpg", "10.2 5.9 1 10.8 5.1 2 10.5 5.5 3 -4 1 1 9e9 1 1"]
    (write / "images.txt").write_text("\n".join(lines))
    points = [f"{key} 0 0 {z} 0 0 0 0" for key, z in ((1, 3.0), (2, 2.0), (3, -1.0))]
    (write / "points3D.txt").write_text("\n".join(points))
    camera = read_model(write)[0].camera
    text = f"3 PINHOLE {camera.width} {camera.height} {camera.fx} {camera.fy} 1 1"
    (write / "cameras.txt").write_text(text)
    for path in write.glob("*.bin"):
        path.unlink()
    depth = ColmapSource(workspace).frame(0).depth
    assert (np.count_nonzero(depth), depth[5, 10]) == (1, 2.0)


def test_known_distances_tell_the_scale(workspace: Path, room_frames: list[SensorFrame]) -> None:
    centres = [frame.world_from_camera[:3, 3] for frame in room_frames]
    metres = np.linalg.norm(centres[0] - centres[5])
    path = workspace / "tape.txt"
    path.write_text(f"{NAMES[0]} {NAMES[5]} {metres}\n")
    source = ColmapSource(workspace, distances=path)
    pose = source.frame(5).world_from_camera
    np.testing.assert_allclose(pose, room_frames[5].world_from_camera, atol=1e-6)
    assert "1 known distances" in source.notes["scale"]


def test_several_models_are_named(workspace: Path) -> None:
    shutil.copytree(workspace / "sparse/0", workspace / "sparse/11")
    shutil.copytree(workspace / "sparse/0", workspace / "sparse/2")
    with pytest.raises(ProgroundError, match=r"sparse: has several models \(0, 2, 11\).*--model"):
        ColmapSource(workspace)
    assert len(ColmapSource(workspace, model=11)) == 6
    with pytest.raises(ProgroundError, match=r"sparse: has no model 1;.* 0, 2, 11"):
        ColmapSource(workspace, model=1)


def test_a_model_in_sparse_itself_or_given_alone(workspace: Path) -> None:
    (workspace / "sparse/0").rename(workspace / "model")
    (workspace / "sparse").rmdir()
    with pytest.raises(ProgroundError, match="has no COLMAP model"):
        ColmapSource(workspace)
    assert len(ColmapSource(workspace / "model", images=workspace / "images")) == 6
    with pytest.raises(ProgroundError, match=r"model/images: no such folder; pass --images"):
        ColmapSource(workspace / "model")
    (workspace / "model").rename(workspace / "sparse")
    assert len(ColmapSource(workspace)) == 6


def test_each_camera_keeps_its_own(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    shutil.rmtree(workspace / "sparse/0")
    write_text(workspace / "sparse/0", room_frames, room.calibration.color)
    model = workspace / "sparse/0"
    text = (model / "cameras.txt").read_text()
    color = room.calibration.color
    text += f"8 SIMPLE_RADIAL {color.width} {color.height} 99.0 50.0 40.0 0.01\n"
    (model / "cameras.txt").write_text(text)
    text = (model / "images.txt").read_text()
    (model / "images.txt").write_text(text.replace(f" 3 {NAMES[4]}", f" 8 {NAMES[4]}"))
    source = ColmapSource(workspace)
    own = [source.frame(index).calibration for index in range(6)]
    other = Camera(color.width, color.height, 99.0, 99.0, 50.0, 40.0, (0.01, 0.0, 0.0, 0.0, 0.0))
    assert own[4] == Calibration.registered(other)
    assert own[:4] + own[5:] == [None] * 5
    assert source.calibration.color == color


def test_a_distorted_camera_round_trips(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    shutil.rmtree(workspace / "sparse/0")
    camera = replace(room.calibration.color, distortion=(*LENS, 0.0))
    write_text(workspace / "sparse/0", room_frames, camera)
    source = ColmapSource(workspace, depth=workspace / "sensor", scale=METRES_PER_UNIT)
    log = assert_round_trip(source, room_frames, workspace / "log.mcap")
    assert log.calibration == Calibration.registered(camera)
    write_depth_maps(workspace, room_frames, "geometric")
    with pytest.raises(ProgroundError, match=r"depth_maps: belongs to undistorted images"):
        ColmapSource(workspace)


def test_times_by_order_where_numbers_do_not_ascend(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame]
) -> None:
    shutil.rmtree(workspace / "sparse/0")
    write_text(workspace / "sparse/0", room_frames, room.calibration.color)
    path = workspace / "sparse/0/images.txt"
    path.write_text(path.read_text().replace(NAMES[3], "frame-9-1.jpg"))
    (workspace / "images" / NAMES[3]).rename(workspace / "images/frame-9-1.jpg")
    source = ColmapSource(workspace)
    assert source.notes["times"] == "30 Hz, by the order of the names"
    assert [source.frame(i).stamp_ns for i in range(6)] == [i * 10**9 // 30 for i in range(6)]
    np.testing.assert_allclose(
        source.frame(3).world_from_camera[:3, :3],
        room_frames[3].world_from_camera[:3, :3],
        atol=1e-9,
    )


@pytest.mark.parametrize("distorted", [False, True])
def test_images_of_another_size_are_named(
    workspace: Path, room: RoomSource, room_frames: list[SensorFrame], distorted: bool
) -> None:
    shutil.rmtree(workspace / "sparse/0")
    camera = replace(room.calibration.color, distortion=(*LENS, 0.0) if distorted else ())
    write_binary(workspace / "sparse/0", room_frames, replace(camera, width=camera.width + 1))
    kinds = (
        "undistorted images.*original ones" if distorted else "original images.*undistorted ones"
    )
    with pytest.raises(ProgroundError, match=rf"frame-0\.jpg: is .*{kinds}"):
        ColmapSource(workspace)


def test_missing_files_are_named(workspace: Path) -> None:
    (workspace / "images" / NAMES[1]).unlink()
    with pytest.raises(ProgroundError, match=rf"{NAMES[1]}: no such file.*--images"):
        ColmapSource(workspace)
    (workspace / "sparse/0/points3D.bin").unlink()
    with pytest.raises(ProgroundError, match="has no COLMAP model"):
        ColmapSource(workspace)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 1.0, "distances": Path("tape.txt")}, "both tell the scale"),
        ({"scale": 0.0}, "a scale of 0.0 is not above 0"),
        ({"scale": float("nan")}, "a scale of nan"),
        ({"calibration": kinect_calibration()}, "pass --depth too"),
        ({"depth": Path("gone")}, "gone: no such folder"),
    ],
)
def test_options_that_do_not_agree(
    workspace: Path, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ProgroundError, match=message):
        ColmapSource(workspace, **options)  # type: ignore[arg-type]


def test_depth_images_that_cannot_be_told_apart(workspace: Path) -> None:
    shutil.copy(workspace / "sensor/0002-depth.png", workspace / "sensor/2-depth.png")
    with pytest.raises(ProgroundError, match=r"2-depth\.png has the same number as 0002-depth"):
        ColmapSource(workspace, depth=workspace / "sensor")
    (workspace / "empty").mkdir()
    with pytest.raises(ProgroundError, match="empty: has no PNG with the name or the number"):
        ColmapSource(workspace, depth=workspace / "empty")


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"3&2&3&", "is not a depth map"),
        (b"0&2&1&", "is not a depth map"),
        (b"\x89PNG", "is not a depth map"),
        (b"999999&999999&1&", "bytes, which are not those of 999999x999999"),
        (b"2&3&1&" + bytes(24), "is 2x3, but the undistorted image is"),
    ],
)
def test_a_broken_depth_map_is_named(
    workspace: Path, room_frames: list[SensorFrame], header: bytes, message: str
) -> None:
    write_depth_maps(workspace, room_frames, "geometric")
    path = workspace / f"stereo/depth_maps/{NAMES[4]}.geometric.bin"
    path.write_bytes(header)
    with pytest.raises(ProgroundError, match=message) as caught:
        ColmapSource(workspace)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("part", "old", "new", "message"),
    [
        ("cameras", "PINHOLE", "HOLE", r"cameras\.txt:2: the camera model HOLE"),
        ("cameras", "PINHOLE", "FOV", r"cameras\.txt:2: has 4 parameters, FOV has 5"),
        ("cameras", "3 PINHOLE", "3 SIMPLE_PINHOLE", r"cameras\.txt:2: has 4 parameters"),
        ("cameras", "3 PINHOLE", "4 PINHOLE", r"images\.txt:3: its camera 3 is not in"),
        ("cameras", "PINHOLE", "PINHOLE -", r"cameras\.txt:2: has a column"),
        ("cameras", "PINHOLE", "PINHOLE 999999", r"cameras\.txt:2: has 5 parameters"),
        ("images", "\n1 ", "\n1 5", r"images\.txt:3: its pose"),
        ("images", "\n1 ", "\n1 nan ", r"images\.txt:3: "),
        ("images", NAMES[0], f"../{NAMES[0]}", r"images\.txt:3: .*leads out"),
        ("images", NAMES[0], f"/{NAMES[0]}", r"images\.txt:3: .*leads out"),
        ("images", "1.5 2.5 -1", "1.5 2.5", r"images\.txt:4: has columns"),
        ("images", "1.5 2.5 -1", "1.5 2.5 5", r"images\.txt:3: it sees points that"),
        ("images", "1.5 2.5 -1", "inf 2.5 -1", r"images\.txt:3: it has pixels"),
        ("points3D", "\n8 ", "\n8 nan ", r"images\.txt:3: it sees points that are not finite"),
        ("points3D", "\n8 ", "\n8 x ", r"points3D\.txt:3: has a column"),
        ("points3D", "\n8 ", "\n8\n", r"points3D\.txt:3: has 1 columns, not 8"),
    ],
)
def test_a_broken_text_model_is_named(
    workspace: Path,
    room: RoomSource,
    room_frames: list[SensorFrame],
    part: str,
    old: str,
    new: str,
    message: str,
) -> None:
    shutil.rmtree(workspace / "sparse/0")
    write_text(workspace / "sparse/0", room_frames, room.calibration.color)
    path = workspace / f"sparse/0/{part}.txt"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ProgroundError, match=message):
        ColmapSource(workspace)


def test_broken_bytes_raise_nothing_else(workspace: Path, room_frames: list[SensorFrame]) -> None:
    write_depth_maps(workspace, room_frames, "geometric")
    maps = workspace / "stereo/depth_maps"
    targets = [*sorted((workspace / "sparse/0").iterdir()), maps / f"{NAMES[0]}.geometric.bin"]
    rng = np.random.default_rng(8)
    refused = 0
    for turn in range(200):
        path = targets[turn % len(targets)]
        whole = path.read_bytes()
        data = bytearray(whole)
        start = int(rng.integers(min(len(data), 300 if turn % 3 else len(data))))
        if turn % 2:
            data = data[:start]
        else:
            data[start : start + 8] = rng.integers(0, 256, 8, dtype=np.uint8).tobytes()
        path.write_bytes(data)
        try:
            ColmapSource(workspace).frame(0)
        except ProgroundError:
            refused += 1
        path.write_bytes(whole)
    assert 120 < refused < 200


@pytest.mark.parametrize("count", [2**27, 2**40, 2**63])
def test_counts_beyond_the_file_are_refused(workspace: Path, count: int) -> None:
    model = workspace / "sparse/0"
    places = {"cameras": 0, "images": 0, "points3D": 0}
    observations = (model / "images.bin").read_bytes().index(b"\0", 72) + 1
    for part, place in (*places.items(), ("images", observations), ("points3D", 8 + 43)):
        path = model / f"{part}.bin"
        whole = path.read_bytes()
        path.write_bytes(whole[:place] + struct.pack("<Q", count) + whole[place + 8 :])
        with pytest.raises(ProgroundError, match=rf"{part}\.bin"):
            read_model(model)
        path.write_bytes(whole)


def test_recognise(workspace: Path, tmp_path: Path) -> None:
    assert recognise(workspace) == "has a COLMAP model in sparse/0"
    assert recognise(workspace / "sparse/0") == "has a COLMAP model"
    assert recognise(workspace / "images") is None
    assert recognise(workspace / "images" / NAMES[0]) is None
    assert recognise(tmp_path / "gone") is None
    (workspace / "sparse/0/images.bin").unlink()
    assert recognise(workspace) is None
    other = tmp_path / "tum"
    other.mkdir()
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt", "images.txt"):
        (other / name).write_text("")
    assert recognise(other) is None


def rigid_errors_m(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Distances [N] between places [N, 3] after the best rotation and translation."""
    found, wanted = found - found.mean(axis=0), wanted - wanted.mean(axis=0)
    left, _, right = np.linalg.svd(found.T @ wanted)
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return np.linalg.norm(found @ turn - wanted, axis=1)


@pytest.mark.slow
def test_the_kitchen(shared_data: Path, depth_agreement: Callable[..., float]) -> None:
    kitchen, workspace = (
        shared_data / "7scenes_redkitchen/seq-01",
        shared_data / "colmap_redkitchen",
    )
    assert recognise(workspace) == "has a COLMAP model in sparse/0"
    source = ColmapSource(workspace, depth=kitchen, calibration=kinect_calibration())
    assert len(source) == 125
    fitted = float(source.notes["scale"].split()[0])
    # By a similarity of the camera centres to the data set's own poses.
    assert fitted == pytest.approx(0.17254, rel=0.01)
    assert source.frame(2).stamp_ns == 16 * 10**9 // 30
    np.testing.assert_allclose(source.calibration.color.fx, 539.5, atol=0.1)
    depth = cv2.imread(str(kitchen / "frame-000016.depth.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(source.frame(2).depth, np.where(depth == 65535, 0, depth))
    poses = np.stack([source.frame(index).world_from_camera for index in range(125)])
    files = [kitchen / f"frame-{8 * index:06d}.pose.txt" for index in range(125)]
    wanted = np.stack([parse_pose(path.read_text(), where=path) for path in files])
    errors_m = rigid_errors_m(poses[:, :3, 3], wanted[:, :3, 3])
    assert np.median(errors_m) < 0.04  # a similarity, its scale free, leaves as much
    assert errors_m.max() < 0.12
    assert source.warnings == ()
    assert depth_agreement(source, source.frame(0), source.frame(5), 0.05) > 0.9
