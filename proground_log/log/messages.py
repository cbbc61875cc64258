"""ROS 2 messages of a log: their definitions, and to and from what they mean.

The definitions are the public ones of `builtin_interfaces`, `std_msgs`, `sensor_msgs`,
`geometry_msgs` and `tf2_msgs`, and one of our own for regions; an MCAP schema of encoding `ros2msg`
carries them with all they depend on.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from proground_log.camera import FISHEYE_TERMS, Camera, pose_from_quaternion, quaternion_from_pose
from proground_log.errors import ProgroundError
from proground_log.log import cdr

_HEADER = """std_msgs/Header header
"""
HEADER_DEFINITION = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id

================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_COMPRESSED_IMAGE = f"""{_HEADER}string format
uint8[] data
{HEADER_DEFINITION}"""
_IMAGE = f"""{_HEADER}uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{HEADER_DEFINITION}"""
_CAMERA_INFO = f"""{_HEADER}uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
{HEADER_DEFINITION}
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
"""
_TF_MESSAGE = f"""geometry_msgs/TransformStamped[] transforms

================================================================================
MSG: geometry_msgs/TransformStamped
{_HEADER}string child_frame_id
geometry_msgs/Transform transform
{HEADER_DEFINITION}
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation

================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z

================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
"""

COMPRESSED_IMAGE_TYPE = "sensor_msgs/msg/CompressedImage"
REGIONS_TYPE = "proground_msgs/msg/Regions"
_REGIONS = f"""{_HEADER}float32[] boxes  # N x 4: x0 y0 x1 y1 in pixels of the colour image
uint8[] levels  # N: level of the feature pyramid, 0 to 2
uint32 prompts  # K, the prompts of the task
float32[] relevance  # N x K, from 0 to 1
uint8[] embeddings  # N x 512 float16, little endian
bool[] is_box  # N: no mask fitted, the whole box stands in
uint32 height  # of the colour image
uint32 width
uint8[] owner  # 16-bit PNG, height x width: 1 + the region that a pixel belongs to, 0 for none
{HEADER_DEFINITION}"""

DEFINITIONS = {
    COMPRESSED_IMAGE_TYPE: _COMPRESSED_IMAGE,
    "sensor_msgs/msg/Image": _IMAGE,
    "sensor_msgs/msg/CameraInfo": _CAMERA_INFO,
    "tf2_msgs/msg/TFMessage": _TF_MESSAGE,
    REGIONS_TYPE: _REGIONS,
}
"""Message definitions by type name."""

_PIXEL_TYPES: dict[str, np.dtype[Any]] = {
    "16UC1": np.dtype("<u2"),
    "32FC1": np.dtype("<f4"),
    "mono16": np.dtype("<u2"),
}


_DISTORTION_MODELS = {0: "plumb_bob", 4: "equidistant", 5: "plumb_bob", 8: "rational_polynomial"}
"""What ROS calls a lens, by its number of terms."""


def encoder(message_type: str) -> Callable[[object], bytes]:
    """The function that turns a message of this type into CDR bytes."""
    return cdr.encoder(message_type, DEFINITIONS[message_type])


def header(stamp_ns: int, frame_id: str) -> SimpleNamespace:
    """A header; raises a ProgroundError for a time that ROS 2 cannot say."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    if seconds >= 2**31:
        raise ProgroundError(
            f"the time {stamp_ns} ns is later than a ROS 2 message can say",
            where=frame_id,
            todo="check the source's times: in seconds since 1970 or since the start",
        )
    return SimpleNamespace(
        stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame_id
    )


def restamped(encoded: bytes, stamp_ns: int) -> bytes:
    """An encoded message that begins with a header, at another time.

    In CDR the stamp follows the four bytes of the encapsulation.
    """
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return encoded[:4] + struct.pack("<iI", seconds, nanoseconds) + encoded[12:]


def without_stamp(encoded: bytes) -> bytes:
    """What of such a message is left when its time is left out."""
    return encoded[12:]


def stamp_ns(message: Any) -> int:
    """The time in a message's header, in nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def compressed_image(data: bytes, image_format: str, stamp_ns: int, frame_id: str) -> object:
    """A CompressedImage that carries the encoded bytes as they are."""
    return SimpleNamespace(header=header(stamp_ns, frame_id), format=image_format, data=data)


def image(pixels: np.ndarray, encoding: str, stamp_ns: int, frame_id: str) -> object:
    """An Image of [H, W] pixels; `encoding` is one of 16UC1, 32FC1, mono16."""
    height, width = pixels.shape
    pixels = np.ascontiguousarray(pixels, dtype=_PIXEL_TYPES[encoding])
    return SimpleNamespace(
        header=header(stamp_ns, frame_id),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=width * pixels.itemsize,
        data=pixels.tobytes(),
    )


def image_pixels(message: Any, *, where: object) -> np.ndarray:
    """The pixels [H, W] of an Image; a read-only view of its bytes."""
    dtype = _PIXEL_TYPES.get(message.encoding)
    size = message.height * message.width * (dtype.itemsize if dtype else 0)
    if dtype is None or message.is_bigendian or len(message.data) != size:
        raise ProgroundError(
            f"an image of encoding {message.encoding!r}, {message.width}x{message.height} "
            f"and {len(message.data)} bytes cannot be read",
            where=where,
            todo="record the log again",
        )
    return np.frombuffer(message.data, dtype).reshape(message.height, message.width)


def camera_info(camera: Camera, stamp_ns: int, frame_id: str) -> object:
    """A CameraInfo; ROS counts pixel centres as whole numbers."""
    k = camera.k_integer_centres
    projection = np.concatenate([k, np.zeros((3, 1))], axis=1)
    return SimpleNamespace(
        header=header(stamp_ns, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model=_DISTORTION_MODELS[len(camera.distortion)],
        d=list(camera.distortion) or [0.0] * 5,
        k=k.reshape(-1).tolist(),
        r=np.eye(3).reshape(-1).tolist(),
        p=projection.reshape(-1).tolist(),
        binning_x=0,
        binning_y=0,
        roi=SimpleNamespace(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def camera(message: Any, *, where: object) -> Camera:
    """The camera that a CameraInfo describes; raises a ProgroundError for an unknown lens."""
    k = message.k
    is_fisheye = message.distortion_model == _DISTORTION_MODELS[FISHEYE_TERMS]
    distortion = tuple(message.d) if any(message.d) or is_fisheye else ()
    if distortion and message.distortion_model != _DISTORTION_MODELS.get(len(distortion)):
        raise ProgroundError(
            f"a lens of {len(distortion)} terms of {message.distortion_model!r} is not known",
            where=where,
            todo="record the log again",
        )
    return Camera.from_integer_centres(
        message.width, message.height, k[0], k[4], k[2], k[5], distortion
    )


def transform_message(
    parent_from_child: np.ndarray, stamp_ns: int, parent: str, child: str
) -> object:
    """A TFMessage with one transform."""
    x, y, z = parent_from_child[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_from_pose(parent_from_child).tolist()
    transform = SimpleNamespace(
        translation=SimpleNamespace(x=x, y=y, z=z),
        rotation=SimpleNamespace(x=qx, y=qy, z=qz, w=qw),
    )
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=header(stamp_ns, parent), child_frame_id=child, transform=transform
            )
        ]
    )


def parent_from_child(message: Any, *, where: object) -> np.ndarray:
    """The 4x4 matrix of a TFMessage with one transform; not checked to be finite."""
    todo = "record the log again, or leave the frame out"
    if len(message.transforms) != 1:
        what = f"has {len(message.transforms)} transforms, not one"
        raise ProgroundError(what, where=where, todo=todo)
    transform = message.transforms[0].transform
    translation, rotation = transform.translation, transform.rotation
    quaternion = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    norm = np.linalg.norm(quaternion)
    if not np.isfinite(norm):
        raise ProgroundError("the pose has numbers that are not finite", where=where, todo=todo)
    if abs(norm - 1.0) >= 1e-3:
        raise ProgroundError(
            f"the pose is not rigid (its quaternion has length {norm:.4g})",
            where=where,
            todo=todo,
        )
    return pose_from_quaternion(np.array([translation.x, translation.y, translation.z]), quaternion)
