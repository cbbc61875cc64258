"""TUM RGB-D: a hand-held Kinect with motion capture.

A sequence folder has rgb.txt and depth.txt (`time path` a line), groundtruth.txt
(`time tx ty tz qx qy qz qw` a line, world_from_camera) and the images; depth is uint16 / 5000 m.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.association import SECOND_NS, Trajectory, associate, parse_stamp_ns, read_text
from recorders.images import read_color, read_depth

DEPTH_PER_M = 5000
MAX_POSE_GAP_S = 0.1
"""Motion capture runs at 100 Hz or more; over a longer gap a hand-held camera may turn back."""

# The data set's page on intrinsics. Depth was registered to colour by the driver, pixel by pixel,
# so that both images share one camera and its distortion; those of freiburg3 come undistorted.
CAMERAS = {
    "1": Camera.from_integer_centres(
        640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    ),
    "2": Camera.from_integer_centres(
        640, 480, 520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    "3": Camera.from_integer_centres(640, 480, 535.4, 539.2, 320.1, 247.6),
}


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
            calibration: the rig; by default by the freiburg number in the folder's name.
            max_time_difference_s: the largest time between the two images of a pair.

        Raises:
            ProgroundError: a list is missing or broken, the name does not tell the camera, or
                no pair has a pose.
        """
        self.calibration = calibration or _calibration_by_name(source)
        self.label_names: dict[int, str] = {}
        depths, colors = _read_list(source / "depth.txt"), _read_list(source / "rgb.txt")
        trajectory = _read_trajectory(source / "groundtruth.txt")
        depth_stamps_ns, color_stamps_ns = (
            [stamp for stamp, _ in each] for each in (depths, colors)
        )
        limit_ns = round(max_time_difference_s * SECOND_NS)
        pairs = [
            (depths[i], colors[j]) for i, j in associate(depth_stamps_ns, color_stamps_ns, limit_ns)
        ]
        covered = trajectory.covers([depth_stamp_ns for (depth_stamp_ns, _), _ in pairs])
        self._frames = [pairs[i] for i in np.flatnonzero(covered)]
        self.notes = {
            "images without a partner": str(len(depths) - len(pairs)),
            "pairs without a pose": str(len(pairs) - len(self._frames)),
        }
        self.warnings: tuple[str, ...] = ()
        if not self._frames:
            raise ProgroundError(
                f"no frame: {len(depths)} depth and {len(colors)} colour images make "
                f"{len(pairs)} pairs within {max_time_difference_s} s, none with a pose",
                where=source,
                todo="check the times in depth.txt, rgb.txt and groundtruth.txt",
            )
        self._poses = trajectory.at([depth_stamp_ns for (depth_stamp_ns, _), _ in self._frames])

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is float32 in metres, its pose interpolated."""
        (stamp_ns, depth_path), (color_stamp_ns, color_path) = self._frames[index]
        color = read_color(color_path, self.calibration.color)
        depth = read_depth(depth_path, self.calibration.depth)
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=color_stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=np.divide(depth, DEPTH_PER_M, dtype=np.float32),
            world_from_camera=self._poses[index],
        )

    def ground_truth_mesh(self) -> bytes | None:
        """TUM RGB-D has none."""
        return None


def _calibration_by_name(source: Path) -> Calibration:
    """The registered camera of freiburg 1, 2 or 3, whichever the folder's name has."""
    name = source.resolve().name
    match = re.search(r"(?:freiburg|fr)([123])(?!\d)", name, re.IGNORECASE)
    if match is None:
        raise ProgroundError(
            "the folder's name does not tell which Kinect it was",
            where=source,
            todo="put freiburg1, freiburg2 or freiburg3 into the name, or pass the calibration",
        )
    return Calibration.registered(CAMERAS[match[1]])


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
    """Times in nanoseconds and paths of the images in rgb.txt or depth.txt."""
    return [
        (parse_stamp_ns(stamp, where=where), path.parent / name.strip())
        for where, (stamp, name) in _rows(path, columns=2)
    ]


def _read_trajectory(path: Path) -> Trajectory:
    """The poses of groundtruth.txt in order of time; a line that is there twice counts once."""
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
