from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import Calibration, Camera, transform
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.icl_nuim import IclNuimSource, recognise
from recorders.formats.tum import recognise as recognise_tum
from recorders.room.source import CAMERA
from tests.round_trip import assert_round_trip
from tests.writers.icl_nuim import freiburg, published, write_trajectory

CALIBRATION = Calibration.registered(CAMERA)
DEPTH_ATOL_M = 1e-6  # 5000 units a metre hold millimetres.


def sim(frames: list[SensorFrame]) -> str:
    blocks = [
        "\n".join(" ".join(f"{x:.9e}" for x in row) for row in published(frame)[:3])
        for frame in frames
    ]
    return "\n\n".join(blocks) + "\n"


def test_the_room_comes_back_from_its_mirrored_world(
    tmp_path: Path, room_frames: list[SensorFrame]
) -> None:
    write_trajectory(tmp_path, room_frames)
    source = IclNuimSource(tmp_path, calibration=CALIBRATION)
    assert source.notes["frames without a pose"] == "1"
    assert "left-handed" in source.notes["world axes"]
    log = tmp_path / "log.mcap"
    assert_round_trip(source, room_frames[1:], log, depth_atol_m=DEPTH_ATOL_M)
    assert source.frame(0).stamp_ns == source.frame(0).color_stamp_ns == 10**9 // 30
    assert source.frame(0).depth.dtype == np.float32
    assert source.ground_truth_mesh() is None


def test_points_are_the_published_ones_turned_over(
    tmp_path: Path, room_frames: list[SensorFrame], depth_agreement: Callable[..., float]
) -> None:
    """The published camera matrix, fy below 0, and pose give the same points but for y's sign."""
    write_trajectory(tmp_path, room_frames)
    source = IclNuimSource(tmp_path, calibration=CALIBRATION)
    frame = source.frame(0)
    rows, columns = np.nonzero(frame.depth)
    z = frame.depth[rows, columns].astype(np.float64)
    k = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, -CAMERA.fy, CAMERA.cy], [0, 0, 1]])
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    theirs = transform(published(room_frames[1]), (np.linalg.inv(k) @ pixels * z).T)
    ours = transform(frame.world_from_camera, CAMERA.unproject(frame.depth)[rows, columns])
    np.testing.assert_allclose(ours, theirs * (1, -1, 1), atol=1e-5)
    assert depth_agreement(source, frame, source.frame(4), 0.05) > 0.95


def test_the_data_sets_camera(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_trajectory(tmp_path, room_frames[:2])
    camera = Camera(640, 480, 481.2, 480.0, 320.0, 240.0)
    assert IclNuimSource(tmp_path).calibration == Calibration.registered(camera)


def test_blocks_are_of_the_last_frames(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_trajectory(tmp_path, room_frames)
    (tmp_path / "livingRoom2.gt.freiburg").unlink()
    (tmp_path / "livingRoom2n.gt.sim").write_text(sim(room_frames[1:]))
    source = IclNuimSource(tmp_path, calibration=CALIBRATION)
    assert source.notes["frames without a pose"] == "1"
    log = tmp_path / "log.mcap"
    assert_round_trip(source, room_frames[1:], log, depth_atol_m=DEPTH_ATOL_M)
    (tmp_path / "livingRoom2n.gt.sim").write_text(sim(room_frames + room_frames[:1]))
    with pytest.raises(ProgroundError, match=r"gt\.sim: has 7 poses for 6 frames"):
        IclNuimSource(tmp_path)
    (tmp_path / "livingRoom2n.gt.sim").write_text("1 0 0 0\n")
    with pytest.raises(ProgroundError, match=r"gt\.sim: is not a list of 3x4 poses"):
        IclNuimSource(tmp_path)
    (tmp_path / "livingRoom2n.gt.sim").write_text("2 0 0 0\n0 1 0 0\n0 0 1 0\n")
    with pytest.raises(ProgroundError, match=r"gt\.sim, frame 5: the pose is not rigid"):
        IclNuimSource(tmp_path)


def test_the_pose_file(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_trajectory(tmp_path, room_frames)
    # Numbered poses go before those without numbers.
    (tmp_path / "livingRoom2n.gt.sim").write_text("broken")
    assert len(IclNuimSource(tmp_path)) == 5
    elsewhere = tmp_path / "poses.gt.sim"
    elsewhere.write_text(sim(room_frames))
    assert len(IclNuimSource(tmp_path, trajectory=elsewhere)) == 6
    (tmp_path / "traj2.gt.freiburg").write_text(freiburg(room_frames, first=7))
    with pytest.raises(ProgroundError, match=r"several pose files \(living.*, traj2.*`trajectory`"):
        IclNuimSource(tmp_path)
    with pytest.raises(ProgroundError, match=r"traj2\.gt\.freiburg: has a pose for none of 6"):
        IclNuimSource(tmp_path, trajectory=tmp_path / "traj2.gt.freiburg")
    for path in tmp_path.glob("*.gt.*"):
        path.unlink()
    with pytest.raises(ProgroundError, match=r"has no \*\.gt\.freiburg and no \*\.gt\.sim"):
        IclNuimSource(tmp_path)


@pytest.mark.parametrize(
    "line",
    ["0 depth/0.png 0", "0 depth/0.png 0 depth/0.png", "0 ../depth/0.png 0 rgb/0.png", "x"],
)
def test_a_broken_association_is_named(
    tmp_path: Path, room_frames: list[SensorFrame], line: str
) -> None:
    write_trajectory(tmp_path, room_frames[:2])
    (tmp_path / "associations.txt").write_text(f"# depth rgb\n1 rgb/1.png 1 depth/1.png\n{line}\n")
    with pytest.raises(ProgroundError, match=r"associations\.txt:3: is not a pair of images"):
        IclNuimSource(tmp_path)


def test_a_broken_pose_and_a_missing_image_are_named(
    tmp_path: Path, room_frames: list[SensorFrame]
) -> None:
    write_trajectory(tmp_path, room_frames[:2])
    (tmp_path / "depth/1.png").unlink()
    with pytest.raises(ProgroundError, match=r"depth/1\.png: no such file"):
        IclNuimSource(tmp_path, calibration=CALIBRATION).frame(0)
    (tmp_path / "livingRoom2.gt.freiburg").write_text("1 0 0 0 0 0 0\n")
    with pytest.raises(ProgroundError, match=r"livingRoom2\.gt\.freiburg:1: has 7 columns"):
        IclNuimSource(tmp_path)
    (tmp_path / "associations.txt").unlink()
    with pytest.raises(ProgroundError, match=r"associations\.txt: no such file"):
        IclNuimSource(tmp_path)


def test_recognise(tmp_path: Path, room_frames: list[SensorFrame]) -> None:
    write_trajectory(tmp_path / "a", room_frames[:1])
    assert recognise(tmp_path / "a") == "has associations.txt and *.gt.freiburg"
    assert recognise_tum(tmp_path / "a") is None
    (tmp_path / "a/livingRoom2.gt.freiburg").rename(tmp_path / "a/groundtruth.txt")
    for path in (tmp_path / "a", tmp_path / "a/associations.txt", tmp_path / "none", Path("\0")):
        assert recognise(path) is None
