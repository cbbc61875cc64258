"""Fields of the public ROS 2 messages, as their packages publish them, and of our own."""

from __future__ import annotations

_HEADER = ("std_msgs/Header", "header")

DEFINED_TYPES: dict[str, list[tuple[str, str]]] = {
    "builtin_interfaces/Time": [("int32", "sec"), ("uint32", "nanosec")],
    "std_msgs/Header": [("builtin_interfaces/Time", "stamp"), ("string", "frame_id")],
    "sensor_msgs/CompressedImage": [_HEADER, ("string", "format"), ("uint8[]", "data")],
    "sensor_msgs/Image": [
        _HEADER,
        ("uint32", "height"),
        ("uint32", "width"),
        ("string", "encoding"),
        ("uint8", "is_bigendian"),
        ("uint32", "step"),
        ("uint8[]", "data"),
    ],
    "sensor_msgs/CameraInfo": [
        _HEADER,
        ("uint32", "height"),
        ("uint32", "width"),
        ("string", "distortion_model"),
        ("float64[]", "d"),
        ("float64[9]", "k"),
        ("float64[9]", "r"),
        ("float64[12]", "p"),
        ("uint32", "binning_x"),
        ("uint32", "binning_y"),
        ("sensor_msgs/RegionOfInterest", "roi"),
    ],
    "sensor_msgs/RegionOfInterest": [
        ("uint32", "x_offset"),
        ("uint32", "y_offset"),
        ("uint32", "height"),
        ("uint32", "width"),
        ("bool", "do_rectify"),
    ],
    "tf2_msgs/TFMessage": [("geometry_msgs/TransformStamped[]", "transforms")],
    "geometry_msgs/TransformStamped": [
        _HEADER,
        ("string", "child_frame_id"),
        ("geometry_msgs/Transform", "transform"),
    ],
    "geometry_msgs/Transform": [
        ("geometry_msgs/Vector3", "translation"),
        ("geometry_msgs/Quaternion", "rotation"),
    ],
    "geometry_msgs/Vector3": [("float64", "x"), ("float64", "y"), ("float64", "z")],
    "geometry_msgs/Quaternion": [
        ("float64", "x"),
        ("float64", "y"),
        ("float64", "z"),
        ("float64", "w"),
    ],
    "proground_msgs/Regions": [
        _HEADER,
        ("float32[]", "boxes"),
        ("uint8[]", "levels"),
        ("uint32", "prompts"),
        ("float32[]", "relevance"),
        ("uint8[]", "embeddings"),
        ("bool[]", "is_box"),
        ("uint32", "height"),
        ("uint32", "width"),
        ("uint8[]", "owner"),
    ],
}
