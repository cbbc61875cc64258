"""ROS messages of images and cameras, of ROS 1 or 2, as what they mean."""

from __future__ import annotations

import sys
from typing import Any

import cv2
import numpy as np

from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from recorders.formats.ros.compressed_depth import (
    DAMAGED,
    decode_compressed_depth,
    decode_depth_png,
    is_depth_png,
)
from recorders.reading.images import EncodedImage, encoded_image, encoded_png

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

COLOR_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
}
"""Bytes a pixel, and how OpenCV makes RGB of them."""
DEPTH_ENCODINGS: dict[str, np.dtype[Any]] = {
    "16UC1": np.dtype("u2"),
    "mono16": np.dtype("u2"),
    "32FC1": np.dtype("f4"),
}
"""Millimetres, millimetres, metres (ROS's REP 118)."""

LARGEST_SIDE = 16384
"""Pixels; a camera larger than this is a damaged message."""
_TERMS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4, "fisheye": 4}


def frame_id(message: Any) -> str:
    """The coordinate frame in a message's header; ROS 1 may have a slash before it."""
    return str(message.header.frame_id).removeprefix("/")


def is_depth(message: Any) -> bool:
    """Whether an Image or CompressedImage is a depth image, by how it is encoded."""
    if hasattr(message, "encoding"):
        return message.encoding in DEPTH_ENCODINGS
    return "compressedDepth" in message.format or is_depth_png(bytes(message.data)[:26])


def is_color(message: Any) -> bool:
    """Whether an Image or CompressedImage is a colour (or grey) image."""
    if hasattr(message, "encoding"):
        return message.encoding in COLOR_ENCODINGS
    data = bytes(message.data)[:4]
    return not is_depth(message) and data.startswith((b"\xff\xd8\xff", b"\x89PNG"))


def is_grey(message: Any) -> bool:
    """Whether an image has no colours; infrared cameras send such ones beside the colour camera."""
    encoding = message.format if _is_compressed(message) else message.encoding
    return bool(encoding.startswith("mono8"))


def color_image(message: Any, *, where: object) -> EncodedImage:
    """The colour image: the bytes of a CompressedImage, or a PNG of the pixels of an Image.

    Raises:
        ProgroundError: an encoding that is not known, or the image is damaged.
    """
    if _is_compressed(message):
        return encoded_image(bytes(message.data), where=where)
    if message.encoding not in COLOR_ENCODINGS:
        raise ProgroundError(
            f"images of the encoding {message.encoding!r} are not known as colour",
            where=where,
            todo=f"choose another topic with color_topic; known: {', '.join(COLOR_ENCODINGS)}",
        )
    channels, conversion = COLOR_ENCODINGS[message.encoding]
    pixels = _pixels(message, np.dtype("u1"), channels, where)
    try:
        rgb = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error as error:
        what = f"a {message.width}x{message.height} image cannot be {message.encoding}"
        raise ProgroundError(what, where=where, todo=DAMAGED) from error
    return EncodedImage(encoded_png(np.asarray(rgb)), "png", message.width, message.height)


def depth_image(message: Any, camera: Camera, *, where: object) -> np.ndarray:
    """The depth image [H, W]: uint16 in millimetres, or float32 in metres; 0 = not measured.

    Raises:
        ProgroundError: no depth image, damaged, or of another size than its camera's.
    """
    size = camera.width, camera.height
    if not is_depth(message):
        encoding = message.format if _is_compressed(message) else message.encoding
        raise ProgroundError(
            f"images of the encoding {encoding!r} are not known as depth",
            where=where,
            todo="choose another topic with depth_topic; known: compressedDepth, "
            f"{', '.join(DEPTH_ENCODINGS)}",
        )
    if _is_compressed(message):
        data = bytes(message.data)
        if is_depth_png(data):
            return decode_depth_png(data, size, where=where)
        return decode_compressed_depth(data, message.format, size, where=where)
    if (message.width, message.height) != size:
        raise ProgroundError(
            f"the depth image is {message.width}x{message.height}, its camera {size[0]}x{size[1]}",
            where=where,
            todo="name the right depth_info_topic, or pass the calibration",
        )
    depth = _pixels(message, DEPTH_ENCODINGS[message.encoding], 1, where)
    if depth.dtype == np.uint16:
        return depth
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


def camera(message: Any, *, is_rectified: bool, where: object) -> Camera:
    """The camera of a CameraInfo.

    Args:
        message: the CameraInfo; its principal point counts pixel centres as whole numbers.
        is_rectified: whether its images are rectified: then P holds and no lens, else K and D.
        where: the topic, for messages.

    Raises:
        ProgroundError: a camera that was not calibrated, or a lens that is not known.
    """
    k, p, d = (
        [float(number) for number in getattr(message, name, getattr(message, name.upper(), ()))]
        for name in ("k", "p", "d")
    )
    uses_p = is_rectified and len(p) == 12 and p[0] != 0
    fx, fy, cx, cy = (p[0], p[5], p[2], p[6]) if uses_p else (k[0], k[4], k[2], k[5])
    width, height = int(message.width), int(message.height)
    is_sane = min(width, height) > 0 and max(width, height) <= LARGEST_SIDE
    if not (is_sane and np.isfinite([fx, fy, cx, cy]).all() and min(fx, fy) > 0):
        raise ProgroundError(
            f"is no calibrated camera ({width}x{height}, focal lengths {fx:g} and {fy:g})",
            where=where,
            todo="calibrate the camera and pass its calibration",
        )
    lens = () if uses_p else _distortion(message.distortion_model, d, where)
    whole = Camera.from_integer_centres(width, height, fx, fy, cx, cy, lens)
    return _as_read_out(whole, message)


def _as_read_out(whole: Camera, message: Any) -> Camera:
    """The camera of the images where the sensor reads a region only, or several pixels as one."""
    x, y = max(1, int(message.binning_x)), max(1, int(message.binning_y))
    roi = message.roi
    width, height = (roi.width or whole.width) // x, (roi.height or whole.height) // y
    return Camera(
        max(1, int(width)),
        max(1, int(height)),
        whole.fx / x,
        whole.fy / y,
        (whole.cx - roi.x_offset) / x,
        (whole.cy - roi.y_offset) / y,
        whole.distortion,
    )


def _distortion(model: str, terms: list[float], where: object) -> tuple[float, ...]:
    """The lens in the order of OpenCV, which is ROS's; raises a ProgroundError if not known."""
    count = _TERMS.get(model)
    # No terms make a pinhole of all lenses but the fisheye.
    if not any(terms) and count != _TERMS["equidistant"]:
        return ()
    if not any(terms) or count is None or any(terms[count:]) or not np.isfinite(terms).all():
        raise ProgroundError(
            f"a lens of the model {model!r} with {len(terms)} terms is not known",
            where=where,
            todo=f"pass the calibration; known: {', '.join(_TERMS)}",
        )
    return tuple([*terms, *[0.0] * count][:count])


def _is_compressed(message: Any) -> bool:
    return hasattr(message, "format")


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, where: object) -> np.ndarray:
    """The pixels [H, W] or [H, W, channels] of an Image: rows without padding, native bytes."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * dtype.itemsize
    if not (0 < row <= step and height > 0 and step * height <= len(message.data)):
        raise ProgroundError(
            f"{len(message.data)} bytes in rows of {step} make no {width}x{height} image of "
            f"{message.encoding}",
            where=where,
            todo=DAMAGED,
        )
    rows = np.frombuffer(message.data, np.uint8, step * height).reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(dtype)
    pixels = pixels.byteswap() if message.is_bigendian != (sys.byteorder == "big") else pixels
    return pixels.reshape((height, width) if channels == 1 else (height, width, channels))
