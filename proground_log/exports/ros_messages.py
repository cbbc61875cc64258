"""ROS 2 messages of a map: clouds of points, boxes and names of what stands there.

The definitions are the public ones of `sensor_msgs`, `visualization_msgs` and what they depend on,
as ROS 2 has them since Humble.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.log import cdr
from proground_log.log.messages import HEADER_DEFINITION, header
from proground_log.mapping.boxes import OrientedBox

POINT_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
MARKERS_TYPE = "visualization_msgs/msg/MarkerArray"
_SEPARATOR = "=" * 80

_POINT_CLOUD = f"""std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{HEADER_DEFINITION}
{_SEPARATOR}
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count
"""
_MARKERS = f"""visualization_msgs/Marker[] markers

{_SEPARATOR}
MSG: visualization_msgs/Marker
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
{HEADER_DEFINITION}
{_SEPARATOR}
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec

{_SEPARATOR}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation

{_SEPARATOR}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z

{_SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1

{_SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z

{_SEPARATOR}
MSG: std_msgs/ColorRGBA
float32 r
float32 g
float32 b
float32 a

{_SEPARATOR}
MSG: sensor_msgs/CompressedImage
std_msgs/Header header
string format
uint8[] data

{_SEPARATOR}
MSG: visualization_msgs/UVCoordinate
float32 u
float32 v

{_SEPARATOR}
MSG: visualization_msgs/MeshFile
string filename
uint8[] data
"""
DEFINITIONS = {POINT_CLOUD_TYPE: _POINT_CLOUD, MARKERS_TYPE: _MARKERS}
"""Message definitions by type name."""

_UINT16, _UINT32, _FLOAT32 = 4, 6, 7
_POINT_FIELDS = (
    *(("x", 0, _FLOAT32), ("y", 4, _FLOAT32), ("z", 8, _FLOAT32)),
    *(("rgb", 12, _UINT32), ("colors", 16, _UINT32), ("score", 20, _FLOAT32)),
    ("label", 24, _UINT16),
)
_POINT = np.dtype(
    {
        "names": ["position", "rgb", "colors", "score", "label"],
        "formats": [("<f4", 3), "<u4", "<u4", "<f4", "<u2"],
        "offsets": [0, 12, 16, 20, 24],
        "itemsize": 28,
    }
)
_CUBE, _TEXT = 1, 9
_BOX_OPACITY = 0.35
TEXT_M = 0.12
"""Height of a name, and how far above its box it floats."""


def encoder(message_type: str) -> Callable[[object], bytes]:
    """The function that turns a message of one of these types into CDR bytes."""
    return cdr.encoder(message_type, DEFINITIONS[message_type])


def point_cloud(
    points_m: np.ndarray,
    colors: np.ndarray,
    labels: np.ndarray,
    scores: np.ndarray,
    stamp_ns: int,
    frame_id: str,
) -> object:
    """A PointCloud2 with the fields x, y, z, rgb (0x00rrggbb), colors, score and label.

    ROS tools and Foxglove read `rgb`. Rerun does not, but takes a field for the component of its
    Points3D that has the field's name: so there is `colors` (0xrrggbbaa) too.

    Args:
        points_m: [N, 3].
        colors: uint8 [N, 3] RGB.
        labels, scores: uint16 [N] and float32 [N], as `SurfaceLabels` has them.
        stamp_ns, frame_id: when, and in which axes.
    """
    rows = np.zeros(len(points_m), _POINT)
    rows["position"], rows["label"], rows["score"] = points_m, labels, scores
    rows["rgb"] = colors.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    rows["colors"] = rows["rgb"] << 8 | 0xFF
    return SimpleNamespace(
        header=header(stamp_ns, frame_id),
        height=1,
        width=len(rows),
        fields=[
            SimpleNamespace(name=name, offset=offset, datatype=kind, count=1)
            for name, offset, kind in _POINT_FIELDS
        ],
        is_bigendian=False,
        point_step=_POINT.itemsize,
        row_step=rows.nbytes,
        data=rows.tobytes(),
        is_dense=True,
    )


def box_markers(
    number: int,
    box: OrientedBox,
    name: str,
    color: tuple[int, int, int],
    stamp_ns: int,
    frame_id: str,
) -> list[object]:
    """A thing as two Markers: its box, and its name above it.

    Args:
        number: tells it from the others.
        box: where it is.
        name: what it is called.
        color: RGB, 0 to 255.
        stamp_ns, frame_id: when, and in which axes.
    """
    above_m = box.centre_m + (box.extent_m[2] / 2 + TEXT_M) * box.axes[2]
    turn = Rotation.from_matrix(box.axes.T).as_quat(canonical=True)
    upright, white = np.array([0.0, 0.0, 0.0, 1.0]), (255, 255, 255)
    at = header(stamp_ns, frame_id)
    size_m = np.array([0.0, 0.0, TEXT_M])
    return [
        _marker(at, "boxes", number, _CUBE, box.centre_m, turn, box.extent_m, color, _BOX_OPACITY),
        _marker(at, "names", number, _TEXT, above_m, upright, size_m, white, 1.0, name),
    ]


def _marker(
    at: SimpleNamespace,
    namespace: str,
    number: int,
    kind: int,
    position_m: np.ndarray,
    quaternion_xyzw: np.ndarray,
    scale_m: np.ndarray,
    color: tuple[int, int, int],
    opacity: float,
    text: str = "",
) -> object:
    r, g, b = (channel / 255 for channel in color)
    nothing = SimpleNamespace(header=at, format="", data=b"")
    return SimpleNamespace(
        header=at,
        ns=namespace,
        id=number,
        type=kind,
        action=0,
        pose=SimpleNamespace(
            position=_xyz(position_m),
            orientation=SimpleNamespace(
                **dict(zip("xyzw", map(float, quaternion_xyzw), strict=True))
            ),
        ),
        scale=_xyz(scale_m),
        color=SimpleNamespace(r=r, g=g, b=b, a=opacity),
        lifetime=SimpleNamespace(sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=nothing,
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=SimpleNamespace(filename="", data=b""),
        mesh_use_embedded_materials=False,
    )


def _xyz(vector: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(**dict(zip("xyz", map(float, vector), strict=True)))
