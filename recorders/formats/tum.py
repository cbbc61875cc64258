"""TUM RGB-D, and Bonn's dynamic scenes in its layout: a hand-held camera with motion capture.

A sequence folder has rgb.txt and depth.txt (`time path` a line), groundtruth.txt
(`time tx ty tz qx qy qz qw` a line, world_from_camera) and the images; depth is uint16 / 5000 m.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.reading.association import (
    SECOND_NS,
    Trajectory,
    associate,
    parse_stamp_ns,
    read_text,
    span_ns,
)
from recorders.reading.frame_files import FrameFiles
from recorders.reading.layout import holds
from recorders.reading.names import is_inside

DEPTH_PER_M = 5000
MAX_POSE_GAP_S = 0.1
"""Motion capture runs at 100 Hz or more; over a longer gap a hand-held camera may turn back."""


@dataclass(frozen=True, eq=False)
class Rig:
    """What the sequences of one rig have in common.

    Args:
        camera: of both images; the driver registered depth to colour, pixel by pixel.
        depth_per_m: units of the depth images in a metre.
        world_from_listed: 4x4, from the world axes of groundtruth.txt.
        tracked_from_camera: 4x4, to the axes of what motion capture tracked.
        notes: what this assumes, for the log.
    """

    camera: Camera
    depth_per_m: float = DEPTH_PER_M
    world_from_listed: np.ndarray = field(default_factory=lambda: np.eye(4))
    tracked_from_camera: np.ndarray = field(default_factory=lambda: np.eye(4))
    notes: dict[str, str] = field(default_factory=dict)


def _bonn() -> Rig:
    """The Xtion of Bonn, as the data set's page and `compute_global_transformation.py` have it.

    A camera's pose in the world of the published laser scan is T_ros^-1 T T_ros T_m, with T from
    groundtruth.txt. T_m is no rigid transform: it turns, moves and scales by 1.059. A pose cannot
    scale, so depth does; laser scan and depth then agree within some 2 %.
    """
    t_ros = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # its own inverse
    t_m = np.array(
        [
            [1.0157, 0.1828, -0.2389, 0.0113],
            [0.0009, -0.8431, -0.6413, -0.0098],
            [-0.3009, 0.6147, -0.8085, 0.0111],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    u, scales, vt = np.linalg.svd(t_m[:3, :3])
    t_m[:3, :3] = u @ vt
    scale = float(scales.mean())
    return Rig(
        Camera.from_integer_centres(
            640,
            480,
            542.822841,
            542.576870,
            315.593520,
            237.756098,
            (0.039903, -0.099343, -0.000730, -0.000144, 0.0),
        ),
        depth_per_m=DEPTH_PER_M / scale,
        world_from_listed=t_ros,
        tracked_from_camera=t_ros @ t_m,
        notes={"Bonn's T_m": f"poses are T_ros T T_ros T_m, depth x {scale:.4f}, T_m's scale"},
    )


# By a pattern for the folder's name. The data sets' pages on intrinsics; images of freiburg3 come
# undistorted.
RIGS = {
    r"(?:freiburg|fr)1(?!\d)": Rig(
        Camera.from_integer_centres(
            640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
        )
    ),
    r"(?:freiburg|fr)2(?!\d)": Rig(
        Camera.from_integer_centres(
            640, 480, 520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
        )
    ),
    r"(?:freiburg|fr)3(?!\d)": Rig(
        Camera.from_integer_centres(640, 480, 535.4, 539.2, 320.1, 247.6)
    ),
    r"rgbd_bonn_": _bonn(),
}


def recognise(source: Path) -> str | None:
    """Why a path looks like a sequence of TUM RGB-D; None where it does not."""
    if holds(source, "rgb.txt", "depth.txt", "groundtruth.txt"):
        return "has rgb.txt, depth.txt and groundtruth.txt"
    return None


class TumSource:
    """One sequence: each depth image with the closest colour image and the pose at its time."""

    name = "tum"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        max_time_difference_s: float = 0.02,
    ) -> None:
        """Read the lists, pair the images one to one and drop the pairs without a pose.

        Args:
            source: the sequence's folder.
            calibration: the rig; by default by the folder's name, which has the freiburg number
                or begins with rgbd_bonn_.
            max_time_difference_s: the largest time between the two images of a pair.

        Raises:
            ProgroundError: a list is missing or broken, the name does not tell the camera, or
                no pair has a pose.
        """
        limit_ns = span_ns(max_time_difference_s, name="max_time_difference_s")
        self.label_names: dict[int, str] = {}
        depths, colors = _read_list(source / "depth.txt"), _read_list(source / "rgb.txt")
        trajectory = read_trajectory(source / "groundtruth.txt")
        depth_stamps_ns, color_stamps_ns = (
            [stamp for stamp, _ in each] for each in (depths, colors)
        )
        self._rig = _rig(source, calibration)
        self.calibration = calibration or Calibration.registered(self._rig.camera)
        pairs = [
            (depths[i], colors[j]) for i, j in associate(depth_stamps_ns, color_stamps_ns, limit_ns)
        ]
        covered = trajectory.covers([depth_stamp_ns for (depth_stamp_ns, _), _ in pairs])
        with_pose = [pairs[i] for i in np.flatnonzero(covered)]
        self.notes = {
            "images without a partner": str(len(depths) - len(pairs)),
            "pairs without a pose": str(len(pairs) - len(with_pose)),
            **self._rig.notes,
        }
        self.warnings: tuple[str, ...] = ()
        if not with_pose:
            raise ProgroundError(
                f"no frame: {len(depths)} depth and {len(colors)} colour images make "
                f"{len(pairs)} pairs within {max_time_difference_s} s, none with a pose",
                where=source,
                todo="check the times in depth.txt, rgb.txt and groundtruth.txt",
            )
        listed = trajectory.at([depth_stamp_ns for (depth_stamp_ns, _), _ in with_pose])
        poses = self._rig.world_from_listed @ listed @ self._rig.tracked_from_camera
        self._frames = [
            FrameFiles(depth_stamp_ns, color_stamp_ns, color, depth, pose)
            for ((depth_stamp_ns, depth), (color_stamp_ns, color)), pose in zip(
                with_pose, poses, strict=True
            )
        ]

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is float32 in metres, its pose interpolated."""
        return self._frames[index].read(index, self.calibration, depth_per_m=self._rig.depth_per_m)

    def ground_truth_mesh(self) -> bytes | None:
        """TUM RGB-D has none."""
        return None


def _rig(source: Path, calibration: Calibration | None) -> Rig:
    """The rig that the folder's name tells, a link's own before that of where it leads to; where
    none does, whatever has the calibration."""
    for name in (source.absolute().name, source.resolve().name):
        for pattern, rig in RIGS.items():
            if re.search(pattern, name, re.IGNORECASE):
                return rig
    if calibration is None:
        raise ProgroundError(
            "the folder's name does not tell which camera it was",
            where=source,
            todo="put freiburg1, freiburg2 or freiburg3 into the name, or rgbd_bonn_ before it, "
            "or pass the calibration",
        )
    return Rig(calibration.depth)


def _rows(path: Path, columns: int) -> Iterator[tuple[str, list[str]]]:
    """Each line that is no comment: where it is, and its columns."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        fields = line.split(maxsplit=columns - 1)
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{path}:{number}"
        if len(fields) != columns:
            raise ProgroundError(
                f"has {len(fields)} columns, not {columns}",
                where=where,
                todo="mend or remove the line",
            )
        yield where, fields


def _read_list(path: Path) -> list[tuple[int, Path]]:
    """Times in nanoseconds and paths of the images in rgb.txt or depth.txt, each once."""
    images = []
    for where, (stamp, name) in _rows(path, columns=2):
        if not is_inside(name.strip()):
            what = f"{name.strip()[:80]!r} is no file in this folder"
            raise ProgroundError(what, where=where, todo="mend or remove the line")
        images.append((parse_stamp_ns(stamp, where=where), path.parent / name.strip()))
    return list(dict.fromkeys(images))


def read_trajectory(path: Path) -> Trajectory:
    """The poses of a file like groundtruth.txt by time; a line that is there twice counts once.

    Raises:
        ProgroundError: the file is missing, or a line is not a time and a pose.
    """
    poses: set[tuple[int, tuple[float, ...]]] = set()
    for where, (stamp, *numbers) in _rows(path, columns=8):
        try:
            pose = tuple(float(number) for number in numbers)
        except ValueError as error:
            raise ProgroundError(
                "has a column that is not a number", where=where, todo="mend or remove the line"
            ) from error
        poses.add((parse_stamp_ns(stamp, where=where), pose))
    table = np.array([pose for _, pose in sorted(poses)], dtype=np.float64).reshape(-1, 7)
    return Trajectory(
        stamps_ns=np.array(sorted(stamp_ns for stamp_ns, _ in poses), dtype=np.int64),
        positions_m=table[:, :3],
        quaternions_xyzw=table[:, 3:],
        max_gap_ns=round(MAX_POSE_GAP_S * SECOND_NS),
        where=str(path),
    )
