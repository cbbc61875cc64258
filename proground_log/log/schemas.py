"""Which type of message each topic of a log has to carry."""

from __future__ import annotations

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from proground_log.log import topics
from proground_log.log.messages import COMPRESSED_IMAGE_TYPE, DEFINITIONS, REGIONS_TYPE

SENSOR_TYPES = {
    topics.COLOR_INFO: "sensor_msgs/msg/CameraInfo",
    topics.COLOR: COMPRESSED_IMAGE_TYPE,
    topics.DEPTH_INFO: "sensor_msgs/msg/CameraInfo",
    topics.DEPTH: "sensor_msgs/msg/Image",
    topics.TF: "tf2_msgs/msg/TFMessage",
    topics.TF_STATIC: "tf2_msgs/msg/TFMessage",
    topics.LABELS: "sensor_msgs/msg/Image",
    topics.INSTANCES: "sensor_msgs/msg/Image",
    topics.LABELS_PREVIEW: COMPRESSED_IMAGE_TYPE,
}

PERCEPTION_TYPES = {topics.REGIONS: REGIONS_TYPE, topics.REGIONS_PREVIEW: COMPRESSED_IMAGE_TYPE}


def schema_fault(channel: Channel, schema: Schema | None) -> str:
    """What is wrong with how a topic's messages are described; "" for topics of others."""
    wanted = {**SENSOR_TYPES, **PERCEPTION_TYPES}.get(channel.topic)
    if wanted is None:
        return ""
    if channel.message_encoding != MessageEncoding.CDR:
        return f"its messages are encoded as {channel.message_encoding!r}, not 'cdr'"
    if schema is None:
        return "its messages have no schema"
    if schema.name != wanted:
        return f"its messages are of type {schema.name!r}, not {wanted!r}"
    definition = SchemaEncoding.ROS2, DEFINITIONS[wanted].encode()
    if (schema.encoding, schema.data) != definition:
        return f"its schema is not the definition of {wanted!r}"
    return ""
