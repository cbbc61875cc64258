"""ARKitScenes, raw and 3dod: rooms filmed with an iPad's LiDAR.

A video's folder (or VIDEO_frames/ in it) has, 60 times a second, lowres_wide/ (colour),
lowres_depth/ (millimetres) and confidence/, each VIDEO_SECONDS.png, lowres_wide_intrinsics/
(VIDEO_SECONDS.pincam: `width height fx fy cx cy`) and, 10 times a second, lowres_wide.traj
(`time rx ry rz tx ty tz`: camera_from_world as a rotation vector and a translation).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.reading.association import (
    SECOND_NS,
    Trajectory,
    associate,
    parse_stamp_ns,
    read_text,
)
from recorders.reading.images import read_color, read_depth, read_encoded, read_labels
from recorders.reading.lidar import (
    Confidence,
    low_confidence_note,
    phone_calibration,
    require_confidence,
)

TRAJECTORY = "lowres_wide.traj"
NAME_TOLERANCE_NS = 1_500_000
"""Times in names have three decimals, rounded differently from folder to folder."""
MAX_POSE_GAP_S = 0.25
"""Poses come ten times a second; over two that are missing a hand-held camera may turn back."""


@dataclass(frozen=True)
class _Files:
    """Where one frame is; its time is that in the depth image's name."""

    stamp_ns: int
    depth: Path
    color: Path
    intrinsics: Path
    confidence: Path | None


class ArkitscenesSource:
    """One video: each depth image with colour, intrinsics and an interpolated pose."""

    name = "arkitscenes"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        color: Literal["lowres_wide", "vga_wide", "wide"] = "lowres_wide",
        depth: Literal["lowres_depth", "highres_depth"] = "lowres_depth",
        min_confidence: Confidence = 1,
    ) -> None:
        """List the files, match them by time and drop what has no pose.

        Args:
            source: the video's folder.
            calibration: the rig, for all frames; by default each colour image's own intrinsics.
            color: the folder of colour images; raw videos also have vga_wide and wide.
            depth: the folder of depth images; raw videos also have highres_depth, from a laser
                scanner, for the images of wide.
            min_confidence: depth of a lower confidence counts as not measured: 0 keeps all,
                2 only the best.

        Raises:
            ProgroundError: a folder is missing, a file is broken, or no frame has a pose.
        """
        self._min_confidence = require_confidence(min_confidence)
        folder = _frames_folder(source)
        trajectory = _read_trajectory(folder / TRAJECTORY)
        complete, count = _match(folder, color, depth)
        covered = trajectory.covers([files.stamp_ns for files in complete])
        self._frames = [complete[i] for i in np.flatnonzero(covered)]
        if not self._frames:
            raise ProgroundError(
                f"no frame: of {count} depth images, {len(complete)} have a colour image and "
                "intrinsics, none a pose as well",
                where=folder,
                todo=f"check the times in the names and in {TRAJECTORY}",
            )
        self._poses = trajectory.at([files.stamp_ns for files in self._frames])
        first = read_encoded(self._frames[0].depth)
        self._depth_size = first.width, first.height
        self._given = calibration
        self.calibration = calibration or self._own_calibration(self._frames[0])
        self.label_names: dict[int, str] = {}
        self.notes = {
            "images without a partner": str(count - len(complete)),
            "frames without a pose": str(len(complete) - len(self._frames)),
            **low_confidence_note(min_confidence),
        }
        self.warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres."""
        files = self._frames[index]
        cameras = self._given or self._own_calibration(files)
        color = read_color(files.color, cameras.color)
        depth = read_depth(files.depth, cameras.depth)
        if files.confidence is not None and self._min_confidence > 0:
            confidence = read_labels(files.confidence, cameras.depth)
            depth[confidence < self._min_confidence] = 0
        return SensorFrame(
            index=index,
            stamp_ns=files.stamp_ns,
            color_stamp_ns=files.stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=depth,
            world_from_camera=self._poses[index],
            calibration=None if cameras == self.calibration else cameras,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """None: the mesh of ARKitScenes has no classes."""
        return None

    def _own_calibration(self, files: _Files) -> Calibration:
        """The cameras of one frame: colour as its .pincam says, depth in the same view."""
        where = files.intrinsics
        width, height, fx, fy, cx, cy = _floats(read_text(where), 6, where=where)
        if not (min(fx, fy) > 0 and min(width, height) >= 1):
            raise ProgroundError(
                "sizes and focal lengths have to be above 0",
                where=where,
                todo="take the file from the data set again",
            )
        # Apple counts the principal point from the image's corner, as we do.
        color = Camera(int(width), int(height), fx, fy, cx, cy)
        return phone_calibration(color, self._depth_size, where=files.depth)


def recognise(source: Path) -> str | None:
    """Whether a folder, or the one VIDEO_frames in it, has a trajectory and depth of a LiDAR."""
    folder = _frames_folder(source)
    if (folder / TRAJECTORY).is_file() and (folder / "lowres_depth").is_dir():
        return f"has {TRAJECTORY} and lowres_depth"
    return None


def _frames_folder(source: Path) -> Path:
    """The folder itself, or the one VIDEO_frames in it."""
    inner = [path for path in source.glob("*_frames") if (path / TRAJECTORY).is_file()]
    return inner[0] if len(inner) == 1 else source


def _timed_files(folder: Path, suffix: str) -> list[tuple[int, Path]]:
    """The files of a folder by the time in their names, VIDEO_SECONDS.suffix, in nanoseconds."""
    if not folder.is_dir():
        raise ProgroundError(
            "no such folder", where=folder, todo="give a video's folder, of raw or of 3dod"
        )
    matches = [
        (match[1], path)
        for path in folder.iterdir()
        if (match := re.fullmatch(rf"(?:.*_)?(\d+\.\d+)\.{suffix}", path.name))
    ]
    return sorted((parse_stamp_ns(seconds, where=path), path) for seconds, path in matches)


def _match(folder: Path, color: str, depth: str) -> tuple[list[_Files], int]:
    """The frames that have all but a pose, and the number of depth images."""
    depths = _timed_files(folder / depth, "png")
    stamps_ns = [stamp_ns for stamp_ns, _ in depths]

    def at_depth(files: list[tuple[int, Path]]) -> dict[int, Path]:
        """What belongs to each depth image, by its place in the list."""
        pairs = associate(stamps_ns, [stamp_ns for stamp_ns, _ in files], NAME_TOLERANCE_NS)
        return {i: files[j][1] for i, j in pairs}

    colors = at_depth(_timed_files(folder / color, "png"))
    intrinsics = at_depth(_timed_files(folder / f"{color}_intrinsics", "pincam"))
    of_lidar = depth == "lowres_depth" and (folder / "confidence").is_dir()
    confidences = at_depth(_timed_files(folder / "confidence", "png")) if of_lidar else {}
    complete = [
        _Files(stamp_ns, path, colors[i], intrinsics[i], confidences.get(i))
        for i, (stamp_ns, path) in enumerate(depths)
        if i in colors and i in intrinsics
    ]
    return complete, len(depths)


def _floats(text: str, count: int, *, where: object) -> list[float]:
    try:
        values = [float(field) for field in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise ProgroundError(
            f"is not {count} numbers", where=where, todo="take the file from the data set again"
        )
    return values


def _read_trajectory(path: Path) -> Trajectory:
    """The poses as world_from_camera in order of time; a line that is there twice counts once."""
    rows: set[tuple[int, tuple[float, ...]]] = set()
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        where = f"{path}:{number}"
        if line.strip():
            values = _floats(line, 7, where=where)
            rows.add((parse_stamp_ns(line.split()[0], where=where), tuple(values[1:])))
    if not rows:
        raise ProgroundError(
            "has no poses", where=path, todo="download the trajectory, which raw and 3dod have"
        )
    table = np.array([pose for _, pose in sorted(rows)])
    world_from_camera = Rotation.from_rotvec(table[:, :3]).inv()
    return Trajectory(
        stamps_ns=np.array([stamp_ns for stamp_ns, _ in sorted(rows)], dtype=np.int64),
        positions_m=-world_from_camera.apply(table[:, 3:]),
        quaternions_xyzw=world_from_camera.as_quat(),
        max_gap_ns=round(MAX_POSE_GAP_S * SECOND_NS),
        where=str(path),
    )
