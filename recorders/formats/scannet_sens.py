"""ScanNet's `.sens` stream: one file of a scan, colour and depth each with a camera of its own.

Little endian: the cameras, sizes and codings; then, for each frame, world_from_camera of the depth
camera (not finite where tracking was lost), times in microseconds and both encoded images.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from pathlib import Path
from typing import BinaryIO

import numpy as np

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.frame import SensorFrame
from recorders.reading.association import frame_stamp_ns, is_tracked
from recorders.reading.images import encoded_image, encoded_png, require_size

FRAME_RATE_HZ = 30
VERSION = 4
RAW_COLOR, PNG_COLOR, JPEG_COLOR = 0, 1, 2
RAW_DEPTH, ZLIB_DEPTH, OCCI_DEPTH = 0, 1, 2
LONGEST_NAME = 4096
MOST_PIXELS = 2**25
MOST_FRAMES = 10_000_000
"""At 30 Hz, four days: a larger number is damage."""
END_OF_TIME_US = 2**31 * 1_000_000
"""A ROS 2 message has 31 bits for the seconds."""
DOWNLOAD_AGAIN = "download the file again"

_START = struct.Struct("<IQ")
"""Version, and the length of the sensor's name, which follows."""
_HEADER = np.dtype(
    [
        ("intrinsic_color", "<f4", (4, 4)),
        ("extrinsic_color", "<f4", (4, 4)),
        ("intrinsic_depth", "<f4", (4, 4)),
        ("extrinsic_depth", "<f4", (4, 4)),
        ("color_coding", "<i4"),
        ("depth_coding", "<i4"),
        ("color_width", "<u4"),
        ("color_height", "<u4"),
        ("depth_width", "<u4"),
        ("depth_height", "<u4"),
        ("depth_per_m", "<f4"),
        ("frames", "<u8"),
    ]
)
_FRAME = np.dtype(
    [
        ("world_from_camera", "<f4", (4, 4)),
        ("color_us", "<u8"),
        ("depth_us", "<u8"),
        ("color_bytes", "<u8"),
        ("depth_bytes", "<u8"),
    ]
)


def recognise(source: Path) -> str | None:
    """Why the path looks like a `.sens` stream, or None."""
    if source.suffix != ".sens":
        return None
    with source.open("rb") as stream:
        start = stream.read(4)
    is_ours = start == VERSION.to_bytes(4, "little")
    return f"is a .sens stream of version {VERSION}" if is_ours else None


def rig(cameras: dict[str, Camera], base_from: dict[str, np.ndarray]) -> Calibration:
    """The calibration of a scan.

    Args:
        cameras: "color" and "depth".
        base_from: their extrinsics, rigid [4, 4]. ScanNet's own code takes points of the depth
            camera to the colour camera, which is the base, by that of depth.
    """
    depth_from_color = np.linalg.inv(base_from["depth"]) @ base_from["color"]
    return Calibration(cameras["color"], cameras["depth"], depth_from_color)


def camera_of(intrinsic: np.ndarray, width: int, height: int, *, where: object) -> Camera:
    """The camera of an intrinsic matrix [4, 4] that counts pixel centres as whole numbers.

    Raises:
        ProgroundError: it is not one of images of that size.
    """
    fx, fy, cx, cy = (float(intrinsic[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    # Exports often have smaller images beside the matrix of the full size.
    middle = all(0.25 < c / size < 0.75 for c, size in ((cx, width), (cy, height)))
    if not middle or not all(0.1 < f / width < 10 for f in (fx, fy)):
        raise ProgroundError(
            f"has the intrinsics {fx:g} {fy:g} {cx:g} {cy:g}, but the images are {width}x{height}",
            where=where,
            todo="pass the calibration of these images",
        )
    return Camera.from_integer_centres(width, height, fx, fy, cx, cy)


class ScannetSensSource:
    """One scan; frames are in the order of the file, those without a pose left out."""

    name = "scannet-sens"

    def __init__(self, source: Path, *, calibration: Calibration | None = None) -> None:
        """Read the header and, image data left aside, each frame's.

        Args:
            source: the `.sens` file.
            calibration: the rig; by default that of the file.

        Raises:
            ProgroundError: it is no such file or damaged, or no frame has a pose.
        """
        self._path = require_file(source)
        size = source.stat().st_size
        with source.open("rb") as stream:
            self._header = _read_header(stream, source)
            frames, offsets = _read_frames(stream, self._header, size, source)
        if calibration is None:
            calibration = _calibration(self._header, source)
        self.calibration = calibration
        self.label_names: dict[int, str] = {}
        self.warnings: tuple[str, ...] = ()
        count = int(self._header["frames"])
        if len(frames) < count:
            self.warnings = (
                f"{source}: is cut short, only {len(frames)} of its {count} frames are whole; "
                f"the log has those; {DOWNLOAD_AGAIN} for the rest",
            )
        poses = frames["world_from_camera"]
        self._numbers = [number for number, pose in enumerate(poses) if is_tracked(pose)]
        if not self._numbers:
            raise ProgroundError(
                f"none of its {len(frames)} frames has a pose",
                where=source,
                todo="record another scan: this one could not be tracked",
            )
        self._frames, self._offsets = frames, offsets
        for number in self._numbers:
            require_rigid(poses[number], where=f"{source}, frame {number}")
        self.notes = {"frames without a pose": str(len(frames) - len(self._numbers))}
        self._has_times = _has_times(frames[self._numbers])
        if not self._has_times:
            self.notes["times"] = f"{FRAME_RATE_HZ} Hz by number: those of the file do not ascend"

    def __len__(self) -> int:
        return len(self._numbers)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is in millimetres (uint16) where the file's is."""
        number = self._numbers[index]
        frame, where = self._frames[number], f"{self._path}, frame {number}"
        with self._path.open("rb") as stream:
            stream.seek(self._offsets[number])
            color = stream.read(int(frame["color_bytes"]))
            depth = stream.read(int(frame["depth_bytes"]))
        stamp_ns = color_stamp_ns = frame_stamp_ns(number, FRAME_RATE_HZ)
        if self._has_times:
            stamp_ns = int(frame["depth_us"]) * 1000
            color_stamp_ns = int(frame["color_us"]) * 1000
        if self._header["color_coding"] == RAW_COLOR:
            color = _png_of_raw(color, self._header, where)
        image = encoded_image(color, where=where)
        require_size(where, (image.width, image.height), self.calibration.color)
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=color_stamp_ns,
            color=image.data,
            color_format=image.format,
            depth=_decoded_depth(depth, self._header, where),
            world_from_camera=frame["world_from_camera"].astype(np.float64),
        )

    def ground_truth_mesh(self) -> bytes | None:
        """The stream has none."""
        return None


def _damaged(what: str, where: object) -> ProgroundError:
    return ProgroundError(what, where=where, todo=DOWNLOAD_AGAIN)


def _read_header(stream: BinaryIO, path: Path) -> np.void:
    """The one record of `_HEADER`, its sizes and codings checked."""
    start = stream.read(_START.size)
    version, name_length = _START.unpack(start.ljust(_START.size, b"\0"))
    if version != VERSION:
        raise ProgroundError(
            f"is not a .sens stream of version {VERSION}", where=path, todo="check the path"
        )
    if name_length > LONGEST_NAME:
        raise _damaged(f"has a sensor's name of {name_length} characters", path)
    stream.seek(_START.size + name_length)
    data = stream.read(_HEADER.itemsize)
    if len(data) < _HEADER.itemsize:
        raise _damaged("is cut short within its header", path)
    header: np.void = np.frombuffer(data, _HEADER)[0]
    for image in ("color", "depth"):
        width, height = int(header[f"{image}_width"]), int(header[f"{image}_height"])
        if not 0 < width * height <= MOST_PIXELS:
            raise _damaged(f"has {image} images of {width}x{height}", path)
    if header["depth_coding"] == OCCI_DEPTH:
        raise ProgroundError(
            "has depth in the occi coding, which only its authors' library reads",
            where=path,
            todo="convert the stream to zlib depth with that library",
        )
    for image, codings in (
        ("color", (RAW_COLOR, PNG_COLOR, JPEG_COLOR)),
        ("depth", (RAW_DEPTH, ZLIB_DEPTH)),
    ):
        if header[f"{image}_coding"] not in codings:
            raise _damaged(f"has an unknown coding of {image}, {header[f'{image}_coding']}", path)
    if not 0 < header["depth_per_m"] < np.inf:
        raise _damaged(f"has {header['depth_per_m']} units of depth per metre", path)
    if not 0 < header["frames"] <= MOST_FRAMES:
        raise _damaged(f"says that it has {header['frames']} frames", path)
    return header


def _read_frames(
    stream: BinaryIO, header: np.void, size: int, path: Path
) -> tuple[np.ndarray, array[int]]:
    """The records of `_FRAME` of all whole frames, and where each one's images begin."""
    limits = {}
    for image, pixel_bytes in (("color", 3), ("depth", 2)):
        raw_bytes = int(header[f"{image}_width"]) * int(header[f"{image}_height"]) * pixel_bytes
        # What is encoded is smaller, but for noise and remarks in tiny images.
        limits[image] = 2 * raw_bytes + 65536
    records, offsets = bytearray(), array("Q")
    offset = stream.tell()
    for number in range(int(header["frames"])):
        stream.seek(offset)
        record = stream.read(_FRAME.itemsize)
        if len(record) < _FRAME.itemsize:
            break
        frame = np.frombuffer(record, _FRAME)[0]
        sizes = {image: int(frame[f"{image}_bytes"]) for image in limits}
        for image, image_bytes in sizes.items():
            if not 0 < image_bytes <= limits[image]:
                raise _damaged(
                    f"has a {image} image of {image_bytes} bytes", f"{path}, frame {number}"
                )
        offset += _FRAME.itemsize
        if offset + sum(sizes.values()) > size:
            break
        records += record
        offsets.append(offset)
        offset += sum(sizes.values())
    if not offsets:
        raise _damaged("is cut short within its first frame", path)
    return np.frombuffer(bytes(records), _FRAME), offsets


def _calibration(header: np.void, path: Path) -> Calibration:
    cameras, base_from = {}, {}
    for image in ("color", "depth"):
        width, height = int(header[f"{image}_width"]), int(header[f"{image}_height"])
        where = f"{path}, {image} camera"
        cameras[image] = camera_of(header[f"intrinsic_{image}"], width, height, where=where)
        base_from[image] = require_rigid(header[f"extrinsic_{image}"], where=where)
    return rig(cameras, base_from)


def _has_times(frames: np.ndarray) -> bool:
    """Whether the times of the frames can be those of a log."""
    depth_us, color_us = frames["depth_us"], frames["color_us"]
    fits = max(depth_us.max(), color_us.max()) < END_OF_TIME_US
    return bool(fits and (depth_us[1:] > depth_us[:-1]).all())


def _png_of_raw(data: bytes, header: np.void, where: str) -> bytes:
    width, height = int(header["color_width"]), int(header["color_height"])
    if len(data) != width * height * 3:
        raise _damaged(f"its colour is {len(data)} bytes, not {width}x{height} RGB", where)
    return encoded_png(np.frombuffer(data, np.uint8).reshape(height, width, 3))


def _decoded_depth(data: bytes, header: np.void, where: str) -> np.ndarray:
    """Depth [H, W], uint16 in millimetres or float32 in metres."""
    width, height = int(header["depth_width"]), int(header["depth_height"])
    raw_bytes = width * height * 2
    is_whole = True
    if header["depth_coding"] == ZLIB_DEPTH:
        inflate = zlib.decompressobj()
        try:
            data = inflate.decompress(data, raw_bytes + 1)
        except zlib.error as error:
            raise _damaged(f"its depth cannot be decompressed ({error})", where) from error
        is_whole = inflate.eof
    if not is_whole or len(data) != raw_bytes:
        raise _damaged(f"its depth is not the {raw_bytes} bytes of {width}x{height}", where)
    depth = np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)
    if header["depth_per_m"] == 1000:
        return depth
    return np.divide(depth, header["depth_per_m"], dtype=np.float32)
