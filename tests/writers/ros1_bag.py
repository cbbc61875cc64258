"""Writes ros1 bag data as its public description has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recorders.formats.ros.ros1_bag import TF_DEFINITION
from tests.writers.ros_bags import TF, Sent


def write_bag(path: Path, sent: list[Sent], compression: str | None = None) -> Path:
    """Write a ROS 1 bag of the same messages."""
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    store.register(typesys.get_types_from_msg(TF_DEFINITION, TF))
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(writer.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for topic, its_type, stamp_ns, message in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, its_type, typestore=store)
            built = in_ros1(store, its_type, message)
            writer.write(connections[topic], stamp_ns, store.serialize_ros1(built, its_type))
    return path


def in_ros1(store: Any, its_type: str, message: Any) -> Any:
    """The message as ROS 1 has it: headers count, and a camera's matrices have capital names."""
    _, fields = store.fielddefs[its_type]
    values = {}
    for name, (kind, of) in fields:
        value = 0 if name == "seq" else getattr(message, name, None)
        if value is None:
            value = getattr(message, name.lower())
        if kind.name == "NAME" and its_type == "std_msgs/msg/Header" and name == "stamp":
            value = store.types[of](sec=value.sec, nanosec=value.nanosec)
        elif kind.name == "NAME":
            value = in_ros1(store, of, value)
        elif kind.name in ("ARRAY", "SEQUENCE"):
            element_kind, element = of[0]
            if element_kind.name == "NAME":
                value = [in_ros1(store, element, each) for each in value]
            elif isinstance(value, bytes):
                value = np.frombuffer(value, np.uint8)
            else:
                value = np.array(value, dtype=element[0])
        elif name == "frame_id":
            value = f"/{value}"
        values[name] = value
    return store.types[its_type](**values)
