"""Record3D: an iPhone's video with depth, exported as .r3d.

The file is a zip of `metadata` (JSON: w, h, dw, dh, K, perFrameIntrinsicCoeffs, poses, fps,
frameTimestamps) and, for frame N, rgbd/N.jpg, rgbd/N.depth (LZFSE of float32 in metres) and, from
a LiDAR, rgbd/N.conf (LZFSE of uint8: 0 low, 1 medium, 2 high). A pose is `qx qy qz qw tx ty tz`,
world_from_camera in the axes of OpenGL, relative to where the recording began.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

import numpy as np

from proground_log.camera import Calibration, Camera, pose_from_quaternion
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.frame import SensorFrame
from recorders.reading.association import UNIT_TOLERANCE, frame_stamp_ns, parse_stamp_ns
from recorders.reading.axes import opencv_from_opengl
from recorders.reading.images import encoded_image, require_size
from recorders.reading.json_file import numbers, parse_json
from recorders.reading.lidar import (
    Confidence,
    low_confidence_note,
    phone_calibration,
    require_confidence,
)
from recorders.reading.lzfse_decode import decompress

LARGEST_MEMBER_BYTES = 64 * 2**20
LARGEST_SIDE = 4096
"""Of an image, in pixels: more than phones film."""
FASTEST_FPS = 1000
ZIP_DAMAGE = (
    BadZipFile,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OverflowError,
    OSError,
    EOFError,
    struct.error,
    zlib.error,
)
"""What the library raises on bytes that are no zip, or on kinds of zip that it cannot read."""


@dataclass(frozen=True)
class _Entry:
    """One frame: its number in the file, its time, its pose (our axes) and its colour camera."""

    number: int
    stamp_ns: int
    world_from_camera: np.ndarray
    calibration: Calibration | None


class Record3dSource:
    """One recording; frames are in the order of their numbers."""

    name = "record3d"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        min_confidence: Confidence = 1,
    ) -> None:
        """Read the metadata and list the frames.

        Args:
            source: the .r3d file.
            calibration: the rig, for all frames; by default the file's, which refocuses.
            min_confidence: depth of a lower confidence counts as not measured: 0 keeps all,
                2 only the best.

        Raises:
            ProgroundError: the file is no .r3d, is broken or unsafe, or no frame has a pose.
        """
        self._source = require_file(source)
        self._min_confidence = require_confidence(min_confidence)
        self._lock = Lock()
        self._archive, self._members = _open_zip(source)
        where = f"{source}, metadata"
        metadata = parse_json(_text(self._member("metadata"), where=where), where=where)
        if not isinstance(metadata, dict):
            raise _not_there("an object", where)
        depth_size, cameras = _read_cameras(metadata, where)
        self.calibration = calibration or phone_calibration(cameras[0], depth_size, where=where)
        self.label_names: dict[int, str] = {}
        poses, valid = _read_poses(metadata, where)
        stamps_ns, times = _read_stamps(metadata, len(poses), where)
        numbers_there = [n for n in range(len(poses)) if self._is_complete(n)]
        self._frames = [
            _Entry(
                number,
                stamps_ns[number],
                poses[number],
                None
                if calibration or len(cameras) <= number or cameras[number] == cameras[0]
                else phone_calibration(cameras[number], depth_size, where=where),
            )
            for number in numbers_there
            if valid[number]
        ]
        if not self._frames:
            raise ProgroundError(
                f"no frame has an image, depth and a pose (of {len(poses)} poses)",
                where=source,
                todo="export the recording again, with its poses",
            )
        self.notes = {
            "images without a partner": str(len(poses) - len(numbers_there)),
            "frames without a pose": str(len(numbers_there) - len(self._frames)),
            "times": times,
            **low_confidence_note(min_confidence),
        }
        self.warnings = _stillness(self._frames)

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is float32 in metres."""
        entry = self._frames[index]
        cameras = entry.calibration or self.calibration
        name = f"rgbd/{entry.number}"
        color = encoded_image(self._member(f"{name}.jpg"), where=self._where(f"{name}.jpg"))
        require_size(self._where(f"{name}.jpg"), (color.width, color.height), cameras.color)
        depth = self._pixels(f"{name}.depth", cameras.depth, np.dtype("<f4")).astype(np.float32)
        depth[~(np.isfinite(depth) & (depth > 0))] = 0
        if f"{name}.conf" in self._members and self._min_confidence > 0:
            confidence = self._pixels(f"{name}.conf", cameras.depth, np.dtype(np.uint8))
            depth[confidence < self._min_confidence] = 0
        return SensorFrame(
            index=index,
            stamp_ns=entry.stamp_ns,
            color_stamp_ns=entry.stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=depth,
            world_from_camera=entry.world_from_camera,
            calibration=entry.calibration,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """Record3D has none."""
        return None

    def _where(self, name: str) -> str:
        return f"{self._source}, {name}"

    def _is_complete(self, number: int) -> bool:
        return all(f"rgbd/{number}.{kind}" in self._members for kind in ("jpg", "depth"))

    def _member(self, name: str) -> bytes:
        """The bytes of one file in the zip, which says before how many they are."""
        info = self._members.get(name)
        what = "no such file in the zip" if info is None else ""
        if info is not None and info.file_size > LARGEST_MEMBER_BYTES:
            what = f"claims {info.file_size} bytes, more than {LARGEST_MEMBER_BYTES}"
        try:
            if info is not None and not what:
                with self._lock, self._archive.open(info) as stream:
                    return stream.read(LARGEST_MEMBER_BYTES)
        except ZIP_DAMAGE as error:
            what = f"cannot be read ({error})"
        raise ProgroundError(what, where=self._where(name), todo="export the recording again")

    def _pixels(self, name: str, camera: Camera, dtype: np.dtype[Any]) -> np.ndarray:
        """A depth or confidence image [H, W], which is LZFSE of its pixels row by row."""
        size = camera.width * camera.height * dtype.itemsize
        data = decompress(self._member(name), size, where=self._where(name))
        return np.frombuffer(data, dtype).reshape(camera.height, camera.width)


def recognise(source: Path) -> str | None:
    """Whether a path is a .r3d file that is a zip (the films of RED cameras are not)."""
    if source.suffix.lower() != ".r3d":
        return None
    with source.open("rb") as stream:
        return "is a .r3d file" if stream.read(4) == b"PK\x03\x04" else None


def _open_zip(source: Path) -> tuple[ZipFile, dict[str, ZipInfo]]:
    """The zip, and its files by name; refuses names that lead out of it and encrypted files."""
    try:
        archive = ZipFile(source.open("rb"))
    except ZIP_DAMAGE as error:
        raise ProgroundError(
            f"is not a whole zip file ({error})",
            where=source,
            todo="copy the file again, or export the recording again",
        ) from error
    for info in archive.infolist():
        parts = info.filename.replace("\\", "/").split("/")
        fault = ""
        if parts[0] == "" or ".." in parts or ":" in parts[0]:
            fault = "leads out of the zip"
        elif info.flag_bits & 1:
            fault = "is encrypted"
        elif info.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            # The library bounds what these two unpack to, and no other.
            fault = "is compressed in a way that Record3D does not use"
        if fault:
            raise ProgroundError(
                f"the file {info.filename!r} {fault}",
                where=source,
                todo="use only .r3d files that Record3D exported",
            )
    return archive, {info.filename: info for info in archive.infolist()}


def _text(data: bytes, *, where: str) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _not_there("text", where) from error


def _not_there(what: str, where: str) -> ProgroundError:
    return ProgroundError(
        f"the metadata has no {what}",
        where=where,
        todo="export the recording again with a current Record3D",
    )


def _read_cameras(metadata: dict[str, Any], where: str) -> tuple[tuple[int, int], list[Camera]]:
    """Size of the depth image, and the colour camera of each frame, or the one of all."""
    sides = [side for key in ("w", "h", "dw", "dh") if isinstance(side := metadata.get(key), int)]
    if len(sides) != 4 or not all(0 < side <= LARGEST_SIDE for side in sides):
        raise _not_there(f"sizes w, h, dw and dh from 1 to {LARGEST_SIDE}", where)
    width, height, depth_width, depth_height = sides
    if metadata.get("perFrameIntrinsicCoeffs"):
        what = "perFrameIntrinsicCoeffs"
        table = numbers(metadata[what], (-1, 4), what=what, where=where)
    else:
        k = numbers(metadata.get("K"), (9,), what="K", where=where)
        # Versions differ in K's order; in either, the other order's principal point is 0.
        by_columns = (k[2], k[5]) == (0, 0)
        cx, cy = (k[6], k[7]) if by_columns else (k[2], k[5])
        table = np.array([[k[0], k[4], cx, cy]])
    if not (table.size and np.isfinite(table).all() and (table > 0).all()):
        raise _not_there("intrinsics that are all above 0", where)
    # Apple counts the principal point from the image's corner, as we do.
    cameras = [Camera(width, height, fx, fy, cx, cy) for fx, fy, cx, cy in table.tolist()]
    return (depth_width, depth_height), cameras


def _read_poses(metadata: dict[str, Any], where: str) -> tuple[np.ndarray, np.ndarray]:
    """Poses in our axes [N, 4, 4], and which of them are poses, bool [N]."""
    table = numbers(metadata.get("poses"), (-1, 7), what="poses", where=where)
    norms = np.linalg.norm(table[:, :4], axis=1)
    valid = np.isfinite(table).all(axis=1) & (np.abs(norms - 1) <= UNIT_TOLERANCE)
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    for number in np.flatnonzero(valid):
        row = table[number]
        poses[number] = opencv_from_opengl(pose_from_quaternion(row[4:], row[:4]))
    return poses, valid


def _read_stamps(metadata: dict[str, Any], count: int, where: str) -> tuple[list[int], str]:
    """Each frame's time in nanoseconds, and where they come from, for the notes."""
    seconds = metadata.get("frameTimestamps")
    if isinstance(seconds, list) and len(seconds) == count:
        stamps_ns = [
            parse_stamp_ns(str(second), where=f"{where}, frameTimestamps[{number}]")
            for number, second in enumerate(seconds)
        ]
        for number, (before, after) in enumerate(pairwise(stamps_ns), 1):
            if after <= before:
                raise ProgroundError(
                    f"frame {number} has no later time than the one before",
                    where=where,
                    todo="remove frameTimestamps from the metadata: fps is used then",
                )
        return stamps_ns, "frameTimestamps"
    rate = metadata.get("fps")
    if not (isinstance(rate, int | Decimal) and 0 < rate <= FASTEST_FPS and rate == int(rate)):
        raise _not_there("times: one in frameTimestamps for each pose, or a whole fps", where)
    return [frame_stamp_ns(number, int(rate)) for number in range(count)], f"{rate} a second"


def _stillness(frames: list[_Entry]) -> tuple[str, ...]:
    """A warning where all poses are the same: films of the FaceID camera have none."""
    first = frames[0].world_from_camera
    if len(frames) > 1 and all(np.array_equal(f.world_from_camera, first) for f in frames):
        return ("every pose is the same, as in films of the FaceID camera: film with the LiDAR",)
    return ()
