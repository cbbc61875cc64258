from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from proground_log.camera import Calibration, Camera
from proground_log.frame import SensorFrame
from proground_log.log.checking.consistency import (
    GAPS,
    PAIRS_PER_GAP,
    Consistency,
    ConsistencyReport,
)
from recorders.formats.replica import ReplicaSource
from recorders.formats.seven_scenes import SevenScenesSource
from recorders.formats.tum import TumSource
from recorders.reading.axes import opencv_from_opengl
from recorders.room import RoomSource
from recorders.source import Source

Pictures = list[tuple[SensorFrame, Calibration]]
Mistake = Callable[[SensorFrame, Calibration], tuple[SensorFrame, Calibration]]

BODY_FROM_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def judged(pictures: Iterable[tuple[SensorFrame, Calibration]]) -> ConsistencyReport:
    consistency = Consistency()
    for frame, calibration in pictures:
        consistency.add(frame, calibration)
    return consistency.report()


def posed(change: Callable[[np.ndarray], np.ndarray]) -> Mistake:
    return lambda frame, calibration: (
        replace(frame, world_from_camera=change(frame.world_from_camera)),
        calibration,
    )


def filmed(**factors: float) -> Mistake:
    """The depth camera's intrinsics times factors."""

    def change(frame: SensorFrame, calibration: Calibration) -> tuple[SensorFrame, Calibration]:
        camera = calibration.depth
        values = {name: getattr(camera, name) * factor for name, factor in factors.items()}
        return frame, replace(calibration, depth=replace(camera, **values))

    return change


def measured(factor: float) -> Mistake:
    return lambda frame, calibration: (
        replace(frame, depth=frame.depth_m * np.float32(factor)),
        calibration,
    )


def swapped(frame: SensorFrame, calibration: Calibration) -> tuple[SensorFrame, Calibration]:
    camera = calibration.depth
    return frame, replace(calibration, depth=replace(camera, cx=camera.cy, cy=camera.cx))


def along_rays(frame: SensorFrame, calibration: Calibration) -> tuple[SensorFrame, Calibration]:
    lengths = np.linalg.norm(calibration.depth.directions, axis=-1)
    return replace(frame, depth=(frame.depth_m * lengths).astype(np.float32)), calibration


def upside_down(frame: SensorFrame, calibration: Calibration) -> tuple[SensorFrame, Calibration]:
    return replace(frame, depth=frame.depth[::-1]), calibration


def with_quaternion(pose: np.ndarray, shift: int) -> np.ndarray:
    quaternion = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), shift)
    result = pose.copy()
    result[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    return result


def with_scale(pose: np.ndarray, factor: float) -> np.ndarray:
    result = pose.copy()
    result[:3, 3] *= factor
    return result


def with_rotation_transposed(pose: np.ndarray) -> np.ndarray:
    result = pose.copy()
    result[:3, :3] = pose[:3, :3].T
    return result


# What was done to right data, and what the warning has to say.
MISTAKES: dict[str, tuple[Mistake, str]] = {
    "inverted": (posed(np.linalg.inv), "with the poses inverted .*camera-from-world: invert them"),
    "opengl": (posed(opencv_from_opengl), r"x right, y up, z back \(OpenGL's\): turn them"),
    "body": (posed(lambda p: p @ np.linalg.inv(BODY_FROM_CAMERA)), "x forward, y left, z up"),
    "inverted opengl": (
        posed(lambda p: np.linalg.inv(opencv_from_opengl(p))),
        "camera-from-world, and the camera's axes seem to be x right, y up, z back",
    ),
    "mirrored": (upside_down, r"x right, y up, z forward \(mirrored"),
    "wxyz": (posed(lambda p: with_quaternion(p, 1)), "seem to be w x y z, read as x y z w"),
    "xyzw": (posed(lambda p: with_quaternion(p, -1)), "seem to be x y z w, read as w x y z"),
    "wxyz, inverted": (
        posed(lambda p: np.linalg.inv(with_quaternion(np.linalg.inv(p), 1))),
        "as w x y z, before the poses were inverted",
    ),
    "wxyz, not inverted": (
        posed(lambda p: with_quaternion(np.linalg.inv(p), 1)),
        "as w x y z and the poses inverted",
    ),
    "transposed": (posed(with_rotation_transposed), "transpose the rotations"),
    "translation": (
        posed(lambda p: with_rotation_transposed(np.linalg.inv(p))),
        "the position is -R t",
    ),
    "positions in mm": (
        posed(lambda p: with_scale(p, 1000)),
        "positions seem about 1000 times too large, as between millimetres and metres",
    ),
    "positions in km": (
        posed(lambda p: with_scale(p, 1e-3)),
        "positions seem about 1000 times too small",
    ),
    "depth x 1000": (measured(1000), "depth seems about 1000 times too large, as between"),
    "depth / 1000": (measured(1e-3), "depth seems about 1000 times too small, as between"),
    "depth x 5": (measured(5), r"depth seems about 5 times too large.* 1/5000 m"),
    "depth / 5": (measured(0.2), r"depth seems about 5 times too small.* 1/5000 m"),
    "depth x 6.5": (measured(6.5535), r"depth seems about 6.6 times too large.* 1/6553.5 m"),
    "depth / 10": (measured(0.1), "depth seems about 10 times too small"),
    "depth x 1.7": (measured(1.7), "depth seems about 1.7 times too large"),
    "along rays": (along_rays, "distance to the camera: turn it into depth along z"),
    "focal x 2": (filmed(fx=2, fy=2), "focal length .* about 2 times too long"),
    "focal / 1.4": (filmed(fx=1 / 1.4, fy=1 / 1.4), "about 1.4 times too short"),
    "larger image": (
        filmed(fx=2, fy=2, cx=2, cy=2),
        "of an image about 2 times larger: pass the calibration",
    ),
    "smaller image": (filmed(fx=0.5, fy=0.5, cx=0.5, cy=0.5), "image about 2 times smaller"),
    "swapped": (swapped, "with cx and cy swapped"),
}
COARSE = ("inverted", "opengl", "body", "mirrored", "wxyz", "xyzw", "transposed", "positions in mm")
FINE = ("depth x 5", "depth / 5", "depth x 1000", "along rays", "focal x 2", "larger image")


def of_source(source: Source, frames: Iterable[int]) -> Pictures:
    return [(source.frame(index), source.calibration) for index in frames]


@pytest.fixture(scope="module")
def room_pictures(room: RoomSource) -> Pictures:
    return of_source(room, range(0, 24, 2))


@pytest.fixture(scope="module")
def kitchen(shared_data: Path) -> Pictures:
    return of_source(SevenScenesSource(shared_data / "7scenes_redkitchen/seq-01"), range(0, 24, 2))


@pytest.fixture(scope="module")
def house(shared_data: Path) -> Pictures:
    return of_source(ReplicaSource(shared_data / "aws_small_house_labelled"), range(12))


@pytest.fixture(scope="module")
def turning(shared_data: Path) -> Pictures:
    folder = shared_data / "tum_fr1_rpy_sample/rgbd_dataset_freiburg1_rpy"
    return of_source(source := TumSource(folder), range(len(source)))


def test_the_right_room_agrees(room_pictures: Pictures) -> None:
    report = judged(room_pictures)
    assert report.warnings == ()
    assert report.share_agreeing > 0.95
    assert report.median_relative_error < 0.001
    assert report.pairs == 11 + 8
    assert report.note.endswith("19 pairs")
    assert f"{report.share_agreeing:.0%} of depth agrees between frames" in report.note


@pytest.mark.parametrize("name", MISTAKES)
def test_each_mistake_is_named_in_the_room(room_pictures: Pictures, name: str) -> None:
    mistake, named = MISTAKES[name]
    report = judged(mistake(*picture) for picture in room_pictures)
    assert len(report.warnings) == 1
    assert re.search(named, report.warnings[0])


@pytest.mark.parametrize("name", COARSE + FINE)
@pytest.mark.parametrize("data", ["kitchen", "house"])
def test_each_mistake_is_named_in_real_data(
    request: pytest.FixtureRequest, data: str, name: str
) -> None:
    mistake, named = MISTAKES[name]
    report = judged(mistake(*picture) for picture in request.getfixturevalue(data))
    assert len(report.warnings) == 1
    assert re.search(named, report.warnings[0])


@pytest.mark.parametrize("name", COARSE[:-1])
def test_a_turning_camera_tells_of_turns_alone(turning: Pictures, name: str) -> None:
    mistake, named = MISTAKES[name]
    (warning,) = judged(mistake(*picture) for picture in turning).warnings
    assert re.search(named, warning)


@pytest.mark.parametrize("data", ["room_pictures", "kitchen", "house", "turning"])
def test_right_data_never_warns(request: pytest.FixtureRequest, data: str) -> None:
    pictures = request.getfixturevalue(data)
    for start, stop, stride in ((0, 12, 1), (0, 2, 1), (2, 5, 1), (5, 9, 1), (0, 12, 3)):
        report = judged(pictures[start:stop:stride])
        assert report.warnings == ()
        assert report.share_agreeing > 0.85


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_sparse_depth_is_not_judged(kitchen: Pictures, share: float) -> None:
    rng = np.random.default_rng(1)
    sparse = [
        (replace(frame, depth=frame.depth * (rng.random(frame.depth.shape) < share)), calibration)
        for frame, calibration in kitchen
    ]
    report = judged(sparse)
    assert (report.note, report.warnings) == ("too little depth overlaps to judge the poses", ())


@pytest.mark.parametrize(("noise_m", "noise_deg"), [(0.01, 0.5), (0.03, 1.5)], ids=["fair", "poor"])
def test_noisy_poses_are_no_mistake(
    kitchen: Pictures, house: Pictures, noise_m: float, noise_deg: float
) -> None:
    rng = np.random.default_rng(2)

    def shaken(pose: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(rng.normal(size=3) * noise_deg / 1.7, degrees=True)
        result = pose.copy()
        result[:3, :3] = pose[:3, :3] @ turn.as_matrix()
        result[:3, 3] += rng.normal(size=3) * noise_m / 1.7
        return result

    for pictures in (kitchen, house):
        report = judged(posed(shaken)(*picture) for picture in pictures)
        assert report.warnings == ()
        assert "hardly moves" not in report.note


def test_frozen_poses_are_named(house: Pictures) -> None:
    report = judged(posed(lambda _: np.eye(4))(*picture) for picture in house)
    (warning,) = report.warnings
    assert "the poses hardly change, though what the camera sees does" in warning


def test_poses_of_another_recording_are_named_as_no_usual_mistake(house: Pictures) -> None:
    order = np.random.default_rng(3).permutation(len(house))
    mixed = [
        (replace(frame, world_from_camera=house[other][0].world_from_camera), calibration)
        for (frame, calibration), other in zip(house, order, strict=True)
    ]
    (warning,) = judged(mixed).warnings
    assert "no usual mistake explains it" in warning


# A box seen from inside: exact depth for any camera and any pose.
BOX_M = np.array([4.0, 3.0, 2.5])
CAMERA = Camera(320, 240, 220.0, 220.0, 160.0, 120.0)


def in_the_box(pose: np.ndarray, camera: Camera, index: int = 0) -> SensorFrame:
    rays = camera.directions.astype(np.float64) @ pose[:3, :3].T
    walls = np.where(rays > 0, BOX_M / 2, -BOX_M / 2) - pose[:3, 3]
    with np.errstate(divide="ignore"):
        depth_m = (walls / rays).min(axis=-1).astype(np.float32)
    return SensorFrame(index, index, index, b"", "png", depth_m, pose)


def way(count: int, step_m: float, step_deg: float) -> list[np.ndarray]:
    poses = []
    for i in range(count):
        pose = np.eye(4)
        angles = [step_deg * i, step_deg * i / 2, step_deg * i / 3]
        pose[:3, :3] = Rotation.from_euler("yxz", angles, degrees=True).as_matrix()
        pose[:3, 3] = np.array([1.0, -0.5, 0.3]) * step_m * i
        poses.append(pose)
    return poses


def box_film(poses: Iterable[np.ndarray], camera: Camera = CAMERA) -> Pictures:
    calibration = Calibration.registered(camera)
    return [(in_the_box(pose, camera, i), calibration) for i, pose in enumerate(poses)]


def test_a_camera_that_stands_still_proves_nothing() -> None:
    film = box_film(way(8, 0.0, 0.0))
    for mistake in (lambda *picture: picture, MISTAKES["inverted"][0], measured(5)):
        report = judged(mistake(*picture) for picture in film)
        assert report.warnings == ()
        assert report.note.endswith("; the camera hardly moves: poses cannot be judged")


def test_a_camera_that_only_turns_tells_nothing_of_scale() -> None:
    film = box_film(way(10, 0.0, 6.0))
    report = judged(film)
    assert report.warnings == ()
    assert "hardly moves" not in report.note
    for factor in (0.001, 0.2, 5, 1000):
        assert judged(measured(factor)(*picture) for picture in film).warnings == ()
    (warning,) = judged(MISTAKES["opengl"][0](*picture) for picture in film).warnings
    assert "camera's axes" in warning
    (warning,) = judged(MISTAKES["focal x 2"][0](*picture) for picture in film).warnings
    assert "focal length" in warning


@pytest.mark.parametrize(
    "distortion", [(0.26, -0.95, -0.005, 0.003, 1.16), (-0.02, 0.01, 0.0, 0.0)]
)
def test_lens_distortion_is_removed(distortion: tuple[float, ...]) -> None:
    lens = replace(CAMERA, distortion=distortion)
    report = judged(box_film(way(12, 0.05, 5.0), lens))
    assert report.warnings == ()
    assert report.share_agreeing > 0.98
    assert report.median_relative_error < 0.005


def test_a_frames_own_cameras_go_first() -> None:
    """A phone that refocuses: every frame another focal length, in another size."""
    own = [replace(CAMERA, fx=f, fy=f) for f in np.linspace(200, 260, 12).tolist()]
    own[3] = own[3].scaled_to_width(160)
    recorded = Calibration.registered(replace(CAMERA, fx=90.0, fy=90.0))
    film = [
        (replace(in_the_box(pose, camera), calibration=Calibration.registered(camera)), recorded)
        for pose, camera in zip(way(12, 0.05, 5.0), own, strict=True)
    ]
    report = judged(film)
    assert report.warnings == ()
    assert report.median_relative_error < 0.001


def test_millimetres_and_metres_are_judged_alike(room_pictures: Pictures) -> None:
    in_m = [(replace(frame, depth=frame.depth_m), cal) for frame, cal in room_pictures]
    assert room_pictures[0][0].depth.dtype == np.uint16
    assert judged(in_m) == judged(room_pictures)


def test_frames_that_cannot_be_judged_are_passed_over() -> None:
    film = box_film(way(8, 0.05, 5.0))
    frame, calibration = film[0]
    broken = frame.depth.copy()
    broken[::2] = np.inf
    broken[1::4] = np.nan
    broken[3::4] = -1
    for frames, pairs in (
        ([], 0),
        ([film[0]], 0),
        ([(replace(frame, depth=np.zeros_like(frame.depth)), calibration)] * 3, 0),
        ([(replace(frame, depth=broken), calibration)] * 3, 0),
        ([(replace(frame, depth=frame.depth[:9]), calibration)] * 3, 0),
        ([(replace(frame, world_from_camera=np.full((4, 4), np.nan)), calibration)] * 3, 0),
    ):
        report = judged(frames)
        assert (report.pairs, report.warnings) == (pairs, ())
        assert np.isnan(report.median_relative_error)
        assert np.isnan(report.share_agreeing)
        assert report.note == "too little depth overlaps to judge the poses"


def test_a_long_recording_is_thinned_evenly_and_kept_small() -> None:
    """The one part that is wrong, wherever it lies, is among the pairs that are kept."""
    film = box_film(way(40, 0.02, 2.0))
    there_and_back = [*film, *film[::-1]] * 8
    consistency = Consistency()
    for picture in there_and_back:
        consistency.add(*picture)
    report = consistency.report()
    assert report.warnings == ()
    assert PAIRS_PER_GAP / 2 * len(GAPS) - 4 <= report.pairs <= PAIRS_PER_GAP * len(GAPS)
    for part in (0, 3):
        wrong = range(part * 160, part * 160 + 160)
        mixed = [
            MISTAKES["inverted"][0](*picture) if i in wrong else picture
            for i, picture in enumerate(there_and_back)
        ]
        assert judged(mixed).share_agreeing < report.share_agreeing - 0.03


def test_the_same_frames_give_the_same_report(house: Pictures) -> None:
    inverted = [MISTAKES["inverted"][0](*picture) for picture in house]
    assert judged(inverted) == judged(inverted)


def test_looking_at_a_frame_costs_less_than_a_millisecond(kitchen: Pictures) -> None:
    consistency = Consistency()
    consistency.add(*kitchen[0])
    spent_s = []
    for picture in kitchen[1:]:
        start_s = time.perf_counter()
        consistency.add(*picture)
        spent_s.append(time.perf_counter() - start_s)
    assert np.median(spent_s) < 1e-3
