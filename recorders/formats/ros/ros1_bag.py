"""ROS 1 bags: a .bag file of version 2.0, read by the package rosbags.

Topics, cameras and poses as in a ROS 2 bag.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any

import lz4.frame  # type: ignore[import-untyped]

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from recorders.formats.ros.source import RosBagSource
from recorders.formats.ros.topics import TF, Bag, Key
from recorders.reading.association import SECOND_NS

INSTALL = "pip install 'proground-log[ros1]'"
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
OLD_TF = "tf/msg/tfMessage"
"""What transforms were before tf2, the same in bytes."""
MAGIC = b"#ROSBAG V2.0\n"
LARGEST_CHUNK_BYTES = 2**28
"""Unpacked; rosbag closes a chunk once it holds 768 KiB."""
REINDEX = "mend it with `rosbag reindex` or `rosbag fix`, or copy it again"
_STAMP = struct.Struct("<III")
"""A header's number, seconds and nanoseconds."""


class Ros1BagSource(RosBagSource):
    """A bag of ROS 1: a .bag file."""

    name = "ros1-bag"

    @staticmethod
    def open_bag(source: Path) -> Bag:
        """The bag; raises a ProgroundError where it is damaged or what reads it is missing."""
        return _Ros1Bag(source)


def recognise(source: Path) -> str | None:
    """What makes a path look like a ROS 1 bag; None where it does not."""
    with source.open("rb") as stream:
        return "begins with #ROSBAG V2.0" if stream.read(len(MAGIC)) == MAGIC else None


def _bounded(decompressor: Callable[[], Any], data: bytes) -> bytes:
    """A chunk unpacked, unless it is a bomb: the package would fill the memory with one."""
    unpacked = decompressor().decompress(data, max_length=LARGEST_CHUNK_BYTES + 1)
    if len(unpacked) > LARGEST_CHUNK_BYTES:
        raise ValueError(f"a chunk unpacks to more than {LARGEST_CHUNK_BYTES} bytes")
    return bytes(unpacked)


_BOUNDED: dict[Callable[[bytes], bytes], Callable[[bytes], bytes]] = {
    bz2.decompress: partial(_bounded, bz2.BZ2Decompressor),
    lz4.frame.decompress: partial(_bounded, lz4.frame.LZ4FrameDecompressor),
}
"""In place of what the package unpacks with."""


class _Ros1Bag:
    """A .bag file; one thread reads at a time."""

    def __init__(self, path: Path) -> None:
        self.path, self._lock = path, Lock()
        if recognise(require_file(path)) is None:
            raise ProgroundError(
                "is no ROS 1 bag of version 2.0", where=path, todo="give a .bag file"
            )
        try:
            rosbag1: Any = import_module("rosbags.rosbag1")
            typesys: Any = import_module("rosbags.typesys")
        except ImportError as error:
            raise ProgroundError(
                f"ROS 1 bags need more ({error})", where=path, todo=INSTALL
            ) from error
        store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
        # The one type of those that matter which the package does not bring along.
        store.register(typesys.get_types_from_msg(TF_DEFINITION, TF))
        self._decode: Callable[[bytes, str], Any] = store.deserialize_ros1
        self._bag = rosbag1.Reader(path)
        with self._damage_named(""):
            self._bag.open()
            for place, chunk in self._bag.chunks.items():
                bounded = _BOUNDED.get(chunk.decompressor, chunk.decompressor)
                self._bag.chunks[place] = chunk._replace(decompressor=bounded)
        self._connections = {each.id: each for each in self._bag.connections}
        self.types: dict[str, str] = {
            each.topic: TF if each.msgtype == OLD_TF else each.msgtype
            for each in self._bag.connections
        }

    def scan(self, topics: Iterable[str]) -> Iterator[tuple[str, Key, bytes]]:
        """Topic, place and bytes of each message of these topics, in order of time."""
        wanted = set(topics)
        connections = [each for each in self._connections.values() if each.topic in wanted]
        latest: dict[int, tuple[int, int]] = {}
        for connection, time_ns, data in self._messages(connections):
            # Several messages of one connection may have the same time: they are counted.
            last_ns, last = latest.get(connection.id, (-1, -1))
            count = last + 1 if time_ns == last_ns else 0
            latest[connection.id] = time_ns, count
            yield connection.topic, (connection.id, time_ns, count), data

    def read(self, topic: str, key: Key) -> Any:
        """The message at a place, decoded."""
        connection_id, time_ns, count = key
        with self._lock:
            found = self._messages([self._connections[connection_id]], time_ns, time_ns + 1)
            _, _, data = next(islice(found, count, None))
        return self.decode(topic, data)

    def decode(self, topic: str, data: bytes) -> Any:
        """A message of a topic, decoded; raises a ProgroundError where it is damaged."""
        with self._damage_named(topic):
            return self._decode(data, self.types[topic])

    def stamp_ns(self, topic: str, data: bytes) -> int:
        """The time in the header that a message begins with, in nanoseconds."""
        with self._damage_named(topic):
            _, seconds, nanoseconds = _STAMP.unpack_from(data)
        return int(seconds) * SECOND_NS + int(nanoseconds)

    def _messages(self, connections: list[Any], *span_ns: int) -> Iterator[tuple[Any, int, bytes]]:
        if connections:
            with self._damage_named(", ".join(sorted(each.topic for each in connections))):
                yield from self._bag.messages(connections, *span_ns)

    @contextmanager
    def _damage_named(self, topic: str) -> Iterator[None]:
        try:
            yield
        except ProgroundError:
            raise
        # The package promises no errors of its own: damage comes out as whatever it led to.
        except Exception as error:
            raise ProgroundError(
                f"the bag is damaged ({error or type(error).__name__})",
                where=f"{self.path}, {topic}" if topic else self.path,
                todo=REINDEX,
            ) from error
