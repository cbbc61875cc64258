"""Bags for tests, written by the public definitions of ROS's messages: the room on a robot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic

from proground_log.camera import Camera, pose_from_quaternion
from proground_log.frame import SensorFrame
from proground_log.log import messages
from recorders.formats.ros.definitions import POSE_DEFINITIONS

START_NS = 1_700_000_000 * 10**9
COLOR_LATER_NS = 4_000_000
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, TF = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
DEPTH_FRAME, COLOR_FRAME = "camera_depth_optical_frame", "camera_color_optical_frame"

DEFINITIONS = {**messages.DEFINITIONS, **POSE_DEFINITIONS}

Sent = tuple[str, str, int, Any]
"""Topic, type, time and message."""

BASE_FROM_CAMERA = pose_from_quaternion(
    np.array([0.1, 0.02, 0.4]), np.array([-0.5, 0.5, -0.5, 0.5])
)
MAP_FROM_ODOM = pose_from_quaternion(np.array([1.0, -2.0, 0.0]), np.array([0, 0, 0.6, 0.8]))


def transform(
    parent_from_child: np.ndarray, stamp_ns: int, parent: str, child: str, topic: str = "/tf"
) -> Sent:
    message = messages.transform_message(parent_from_child, stamp_ns, parent, child)
    return topic, TF, stamp_ns, message


def robot(frames: Sequence[SensorFrame], depth_from_color: np.ndarray) -> list[Sent]:
    """map -> odom -> base_link -> camera_link -> the cameras' optical frames."""
    sent = []
    for parent, child, pose in (
        ("base_link", "camera_link", BASE_FROM_CAMERA),
        ("camera_link", DEPTH_FRAME, np.eye(4)),
        (DEPTH_FRAME, COLOR_FRAME, depth_from_color),
    ):
        sent.append(transform(pose, START_NS, parent, child, "/tf_static"))
    for frame in frames:
        # SLAM's correction drifts, and what odometry says drifts the other way.
        drift = np.eye(4)
        drift[0, 3] = 0.01 * frame.index
        map_from_odom = MAP_FROM_ODOM @ drift
        map_from_base = frame.world_from_camera @ np.linalg.inv(BASE_FROM_CAMERA)
        odom_from_base = np.linalg.inv(map_from_odom) @ map_from_base
        stamp_ns = START_NS + frame.stamp_ns
        sent.append(transform(map_from_odom, stamp_ns, "map", "odom"))
        sent.append(transform(odom_from_base, stamp_ns, "odom", "base_link"))
    return sent


def color_message(frame: SensorFrame, kind: str) -> tuple[str, str, Any]:
    """What follows the camera's name, type and message; `kind` is jpeg or an Image's encoding."""
    stamp_ns = START_NS + frame.stamp_ns + COLOR_LATER_NS
    if kind == "jpeg":
        name = "rgb8; jpeg compressed bgr8"
        message = messages.compressed_image(frame.color, name, stamp_ns, COLOR_FRAME)
        return "image_raw/compressed", COMPRESSED, message
    rgb = frame.decode_color()
    pixels = {
        "rgb8": rgb,
        "bgr8": rgb[..., ::-1],
        "rgba8": np.dstack([rgb, rgb[..., :1]]),
        "bgra8": np.dstack([rgb[..., ::-1], rgb[..., :1]]),
        "mono8": rgb[..., :1],
    }[kind]
    return "image_raw", IMAGE, raw_image(pixels, kind, stamp_ns, COLOR_FRAME, padding=12)


def raw_image(
    pixels: np.ndarray,
    encoding: str,
    stamp_ns: int,
    frame_id: str,
    *,
    padding: int = 0,
    is_bigendian: bool = False,
) -> Any:
    if is_bigendian:
        pixels = pixels.byteswap()
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=7)
    return SimpleNamespace(
        header=messages.header(stamp_ns, frame_id),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(is_bigendian),
        step=rows.shape[1],
        data=rows.tobytes(),
    )


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def depth_message(frame: SensorFrame, kind: str) -> tuple[str, str, Any]:
    stamp_ns = START_NS + frame.stamp_ns
    if kind.startswith("big "):
        pixels, encoding = depth_pixels(frame, kind.removeprefix("big "))
        image = raw_image(pixels, encoding, stamp_ns, DEPTH_FRAME, padding=6, is_bigendian=True)
        return "image_rect_raw", IMAGE, image
    if kind in ("16UC1", "32FC1", "mono16"):
        pixels, encoding = depth_pixels(frame, kind)
        return "image_rect_raw", IMAGE, raw_image(pixels, encoding, stamp_ns, DEPTH_FRAME)
    if kind == "png":
        data, name = png(frame.depth), "16UC1; png compressed"
        message = messages.compressed_image(data, name, stamp_ns, DEPTH_FRAME)
        return "image_rect_raw/compressed", COMPRESSED, message
    data = compressed_depth(frame, kind)
    message = messages.compressed_image(data, kind, stamp_ns, DEPTH_FRAME)
    return "image_rect_raw/compressedDepth", COMPRESSED, message


def depth_pixels(frame: SensorFrame, encoding: str) -> tuple[np.ndarray, str]:
    if encoding != "32FC1":
        return frame.depth, encoding
    depth_m = frame.depth_m.copy()
    depth_m[0, :3] = np.nan, np.inf, -1
    return depth_m, encoding


def compressed_depth(frame: SensorFrame, image_format: str) -> bytes:
    """As compressed_depth_image_transport has it, with its default parameters of 100 m and 10 m."""
    a, b = 0.0, 0.0
    numbers = frame.depth
    if image_format.startswith("32FC1"):
        quantization, depth_max = 100.0, 10.0
        a = quantization * (quantization + 1)
        b = 1 - a / depth_max
        with np.errstate(divide="ignore"):
            inverse = a / frame.depth_m + b
        numbers = np.where(frame.depth > 0, inverse, 0).astype(np.uint16)
    header = np.int32(0).tobytes() + np.float32([a, b]).tobytes()
    return header + (rvl(numbers) if image_format.endswith("rvl") else png(numbers))


def rvl(pixels: np.ndarray) -> bytes:
    """Encode as Wilson's paper says, number by number."""
    digits: list[int] = []

    def put(number: int) -> None:
        while True:
            number, digit = number >> 3, number & 7
            digits.append(digit | 8 if number else digit)
            if not number:
                return

    flat, at, previous = pixels.ravel().tolist(), 0, 0
    while at < len(flat):
        start = at
        while at < len(flat) and flat[at] == 0:
            at += 1
        put(at - start)
        start = at
        while at < len(flat) and flat[at] != 0:
            at += 1
        put(at - start)
        for number in flat[start:at]:
            change, previous = number - previous, number
            put(2 * change if change >= 0 else -2 * change - 1)
    digits += [0] * (-len(digits) % 8)
    words = [
        int("".join(f"{d:x}" for d in digits[i : i + 8]), 16) for i in range(0, len(digits), 8)
    ]
    height, width = pixels.shape
    return np.array([width, height, *words], dtype="<u4").tobytes()


def room_messages(
    frames: Sequence[SensorFrame],
    camera: Camera,
    *,
    color: str = "jpeg",
    depth: str = "16UC1",
    depth_from_color: np.ndarray | None = None,
) -> list[Sent]:
    """Everything that a robot with a depth camera sends, in order of time."""
    sent = robot(frames, np.eye(4) if depth_from_color is None else depth_from_color)
    for frame in frames:
        for sensor, message in (
            ("color", color_message(frame, color)),
            ("depth", depth_message(frame, depth)),
        ):
            name, its_type, content = message
            stamp_ns = messages.stamp_ns(content)
            info = messages.camera_info(camera, stamp_ns, content.header.frame_id)
            sent.append((f"/camera/{sensor}/camera_info", INFO, stamp_ns, info))
            sent.append((f"/camera/{sensor}/{name}", its_type, stamp_ns, content))
    return sorted(sent, key=lambda each: each[2])


def odometry(frame: SensorFrame) -> Any:
    """Where base_link is in the room."""
    world_from_base = frame.world_from_camera @ np.linalg.inv(BASE_FROM_CAMERA)
    stamp_ns = START_NS + frame.stamp_ns
    none = SimpleNamespace(x=0.0, y=0.0, z=0.0)
    return SimpleNamespace(
        header=messages.header(stamp_ns, "odom"),
        child_frame_id="base_link",
        pose=SimpleNamespace(pose=pose(world_from_base), covariance=[0.0] * 36),
        twist=SimpleNamespace(
            twist=SimpleNamespace(linear=none, angular=none), covariance=[0.0] * 36
        ),
    )


def pose(world_from_body: np.ndarray) -> Any:
    """A geometry_msgs/Pose."""
    sent = messages.transform_message(world_from_body, 0, "", "")
    place = sent.transforms[0].transform  # type: ignore[attr-defined]
    return SimpleNamespace(position=place.translation, orientation=place.rotation)


def write_mcap(
    path: Path,
    sent: Iterable[Sent],
    *,
    compression: CompressionType = CompressionType.ZSTD,
    encode: Any = None,
    **options: Any,
) -> Path:
    """Write a bag as rosbag2 does; `encode` makes bytes of type and message, else CDR."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200_000, compression=compression, **options)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for number, (topic, its_type, time_ns, message) in enumerate(sent):
            definition = DEFINITIONS.get(its_type, "")
            if topic not in channels:
                schema = writer.register_schema(its_type, "ros2msg", definition.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = encode(its_type, message) if encode else cdr(its_type, message)
            writer.add_message(channels[topic], time_ns, data, time_ns, number)
        writer.finish()
    return path


def cdr(its_type: str, message: Any) -> bytes:
    return serialize_dynamic(its_type, DEFINITIONS[its_type])[its_type](message)
