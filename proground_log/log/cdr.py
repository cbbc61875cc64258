"""ROS 2 messages to and from CDR bytes: the one place that touches what mcap_ros2 keeps private."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

# Not public, but the only way to encode without writing a whole MCAP file; pinned below 0.7.
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic


def encoder(message_type: str, definition: str) -> Callable[[object], bytes]:
    """The function that turns a message of a type, with its definition, into CDR bytes."""
    encode: Callable[[object], bytes] = serialize_dynamic(message_type, definition)[message_type]
    return encode


def decoder(message_type: str, definition: str) -> Callable[[bytes], Any]:
    """The function that turns CDR bytes into a message."""
    decode: Callable[[bytes], Any] = generate_dynamic(message_type, definition)[message_type]
    return decode
