"""ScanNet++, the iPhone's stream of a scene.

A scene's iphone/ folder has the video rgb.mkv or rgb.mp4, depth.bin (256x192) and
pose_intrinsic_imu.json: for frame_N the `timestamp`, the `intrinsic` matrix of the video's pixels
and `aligned_pose`, world_from_camera in our axes, metric and aligned with the laser scan.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.frame import SensorFrame
from recorders.formats.scannetpp_depth import HEIGHT, WIDTH, open_depth
from recorders.reading.association import parse_stamp_ns
from recorders.reading.forward import ForwardImages, Images
from recorders.reading.images import encoded_png, require_size
from recorders.reading.json_file import numbers, read_json
from recorders.reading.lidar import phone_calibration

POSES, DEPTH, VIDEOS = "pose_intrinsic_imu.json", "depth.bin", ("rgb.mkv", "rgb.mp4")
LARGEST_SIDE = 8192
"""Of the video, in pixels: a header may claim more, but no phone films it."""
MATROSKA, MP4 = b"\x1aE\xdf\xa3", b"ftyp"


@dataclass(frozen=True)
class _Entry:
    """One frame: its number in the streams, its time and what pose_intrinsic_imu.json says."""

    number: int
    stamp_ns: int
    world_from_camera: np.ndarray
    intrinsic: np.ndarray


class ScannetppSource:
    """One scene; frames are in the order of their numbers."""

    name = "scannetpp"

    def __init__(self, source: Path, *, calibration: Calibration | None = None) -> None:
        """Read the poses and find out how the streams are coded.

        Args:
            source: the scene's folder, or its iphone folder.
            calibration: the rig, for all frames; by default each frame's own intrinsics.

        Raises:
            ProgroundError: a file is missing or broken, or no frame has depth and a pose.
        """
        folder = _iphone_folder(source)
        video = _video_path(folder)
        self._video = ForwardImages(partial(_video_images, video), video)
        self._video_path, self._video_size = video, _video_size(video)
        self._depth = open_depth(folder / DEPTH)
        entries, count = _read_entries(folder / POSES)
        known = self._depth.frames
        self._frames = [e for e in entries if known is None or e.number < known]
        if not self._frames:
            raise ProgroundError(
                f"no frame: of {count}, {len(entries)} have a pose, none depth as well",
                where=folder,
                todo=f"check that {POSES} and {DEPTH} are of the same scene",
            )
        self._given = calibration
        self.calibration = calibration or self._own_calibration(self._frames[0])
        self.label_names: dict[int, str] = {}
        self.notes = {
            "frames without a pose": str(count - len(entries)),
            "images without a partner": str(len(entries) - len(self._frames)),
        }
        self.warnings: tuple[str, ...] = ()
        if self._depth.is_cut:
            self.warnings = (f"{DEPTH} is cut off after {known} frames: copy it again",)

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; colour as PNG, since a video has no bytes of one frame."""
        entry = self._frames[index]
        color = self._video.at(entry.number)
        depth = self._depth.at(entry.number)
        cameras = self._given or self._own_calibration(entry)
        where = f"{self._video_path}, frame {entry.number}"
        require_size(where, (color.shape[1], color.shape[0]), cameras.color)
        return SensorFrame(
            index=index,
            stamp_ns=entry.stamp_ns,
            color_stamp_ns=entry.stamp_ns,
            color=encoded_png(color[..., ::-1]),
            color_format="png",
            depth=depth,
            world_from_camera=entry.world_from_camera,
            calibration=None if cameras == self.calibration else cameras,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """None: the mesh of the laser scan has its classes in other files."""
        return None

    def _own_calibration(self, entry: _Entry) -> Calibration:
        """The cameras of one frame: colour as its matrix says, depth in the same view."""
        (fx, _, cx), (_, fy, cy), _ = entry.intrinsic.tolist()
        # Apple counts the principal point from the image's corner, as we do.
        color = Camera(*self._video_size, fx, fy, cx, cy)
        return phone_calibration(color, (WIDTH, HEIGHT), where=self._video_path)


def recognise(source: Path) -> str | None:
    """Whether a folder, or iphone/ in it, has the poses and depth of ScanNet++."""
    folder = _iphone_folder(source)
    if (folder / POSES).is_file() and (folder / DEPTH).is_file():
        return f"has {POSES} and {DEPTH}"
    return None


def _iphone_folder(source: Path) -> Path:
    inner = source / "iphone"
    return inner if inner.is_dir() else source


def _video_path(folder: Path) -> Path:
    for name in VIDEOS:
        if (folder / name).is_file():
            return folder / name
    raise ProgroundError(
        f"has no {' or '.join(VIDEOS)}", where=folder, todo="give a scene with its iphone folder"
    )


def _video_size(path: Path) -> tuple[int, int]:
    """Width and height of the video; raises a ProgroundError unless it is one."""
    # A text file that names other files or addresses would be followed as a playlist.
    with require_file(path).open("rb") as stream:
        start = stream.read(8)
    is_video = start[:4] == MATROSKA or start[4:] == MP4
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG) if is_video else None
    if capture is None or not capture.isOpened():
        raise ProgroundError(
            "cannot be opened as a video",
            where=path,
            todo="copy it from the data set again; it has to lie on this machine",
        )
    width, height = (
        int(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    capture.release()
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
        raise ProgroundError(
            f"the video claims {width}x{height} pixels",
            where=path,
            todo="copy it from the data set again",
        )
    return width, height


def _video_images(path: Path) -> Images:
    """The video's frames in order, uint8 [H, W, 3] BGR."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    while capture.grab():
        yield lambda: np.asarray(capture.retrieve()[1])
    capture.release()


def _read_entries(path: Path) -> tuple[list[_Entry], int]:
    """The frames that have a pose, in the order of their numbers, and how many there are."""
    content = read_json(path)
    frames = {
        int(match[1]): frame
        for name, frame in (content.items() if isinstance(content, dict) else ())
        if (match := re.fullmatch(r"frame_(\d{1,9})", name)) and isinstance(frame, dict)
    }
    entries = [
        _Entry(
            number,
            parse_stamp_ns(str(frame.get("timestamp")), where=f"{path}, frame_{number:06d}"),
            pose,
            _read_intrinsic(frame, f"{path}, frame_{number:06d}"),
        )
        for number, frame in sorted(frames.items())
        if (pose := _read_pose(frame, f"{path}, frame_{number:06d}")) is not None
    ]
    _require_ascending(entries, path)
    return entries, len(frames)


def _read_pose(frame: dict[str, Any], where: str) -> np.ndarray | None:
    """The pose, or None where tracking was lost."""
    try:
        pose = numbers(frame.get("aligned_pose"), (4, 4), what="aligned_pose", where=where)
        return require_rigid(pose, where=where)
    except ProgroundError:
        return None


def _read_intrinsic(frame: dict[str, Any], where: str) -> np.ndarray:
    intrinsic = numbers(frame.get("intrinsic"), (3, 3), what="intrinsic", where=where)
    if not (np.isfinite(intrinsic).all() and min(intrinsic[0, 0], intrinsic[1, 1]) > 0):
        raise ProgroundError(
            "the focal lengths have to be finite and above 0",
            where=where,
            todo="take the file from the data set again",
        )
    return intrinsic


def _require_ascending(entries: Iterable[_Entry], path: Path) -> None:
    last_ns = -1
    for entry in entries:
        if entry.stamp_ns <= last_ns:
            raise ProgroundError(
                "has no later time than the frame before",
                where=f"{path}, frame_{entry.number:06d}",
                todo="take the file from the data set again",
            )
        last_ns = entry.stamp_ns
