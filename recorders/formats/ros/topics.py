"""Which of a bag's topics are the colour camera, the depth camera and what says where they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from proground_log.errors import ProgroundError
from recorders.formats.ros.messages import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    is_color,
    is_depth,
    is_grey,
)

TF = "tf2_msgs/msg/TFMessage"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSPORTS = ("compressed", "compressedDepth")
"""What image_transport adds to the name of an image's topic."""

Key = tuple[int, ...]
"""Where in its bag a message is; only the bag knows how."""


class Bag(Protocol):
    """A bag on disk, opened and checked. Reading is safe from several threads.

    Attributes:
        path: the file or folder.
        types: type of the messages by topic, in the way of ROS 2: "sensor_msgs/msg/Image".
    """

    path: Path
    types: dict[str, str]

    def scan(self, topics: Iterable[str]) -> Iterator[tuple[str, Key, bytes]]:
        """Topic, place and bytes of each message of these topics, as they stand in the bag."""
        ...

    def read(self, topic: str, key: Key) -> Any:
        """The message at a place, decoded."""
        ...

    def decode(self, topic: str, data: bytes) -> Any:
        """A message of a topic, decoded; raises a ProgroundError where it is damaged."""
        ...

    def stamp_ns(self, topic: str, data: bytes) -> int:
        """The time in the header that a message begins with, in nanoseconds."""
        ...


@dataclass(frozen=True)
class TopicOptions:
    """What the user chose; None for what is to be found."""

    color_topic: str | None = None
    depth_topic: str | None = None
    color_info_topic: str | None = None
    depth_info_topic: str | None = None
    odometry_topic: str | None = None


@dataclass(frozen=True)
class Topics:
    """The topics to read, and the first message of each but those of tf and odometry.

    Args:
        color, depth: images.
        color_info, depth_info: cameras; None where the calibration is given.
        tf: transforms, those that hold at all times among them.
        odometry: poses that stand in for the transforms above the robot.
        first: first messages, by topic.
    """

    color: str
    depth: str
    color_info: str | None
    depth_info: str | None
    tf: tuple[str, ...]
    odometry: str | None
    first: dict[str, Any]


def is_static(topic: str) -> bool:
    """Whether a topic of transforms carries those that hold at all times."""
    return topic.endswith("tf_static")


def is_rectified(image_topic: str) -> bool:
    """Whether an image's topic says, as the names of image_proc do, that its lens is undone."""
    return "rect" in _base(image_topic).rsplit("/", 1)[-1]


def choose_topics(bag: Bag, options: TopicOptions, *, needs_cameras: bool) -> Topics:
    """Find the topics: the one colour and the one depth image that there is, and their cameras.

    Of the same image sent raw and compressed the raw one counts, and grey images count only where
    there is no colour.

    Raises:
        ProgroundError: a topic is missing, or several could be meant; lists them.
    """
    firsts = {
        topic: first
        for topic in _of_types(bag, IMAGE, COMPRESSED_IMAGE)
        if (first := _first(bag, topic)) is not None
    }
    color = options.color_topic or _one_image(bag, firsts, is_color, "colour", "color_topic")
    depth = options.depth_topic or _one_image(bag, firsts, is_depth, "depth", "depth_topic")
    chosen: dict[str, tuple[str, tuple[str, ...]]] = {
        "color_topic": (color, (IMAGE, COMPRESSED_IMAGE)),
        "depth_topic": (depth, (IMAGE, COMPRESSED_IMAGE)),
    }
    if needs_cameras:
        color_info = options.color_info_topic or _info_of(color)
        depth_info = options.depth_info_topic or _info_of(depth)
        chosen["color_info_topic"] = (color_info, (CAMERA_INFO,))
        chosen["depth_info_topic"] = (depth_info, (CAMERA_INFO,))
    if options.odometry_topic is not None:
        chosen["odometry_topic"] = (options.odometry_topic, (ODOMETRY, POSE))
    first = {}
    for option, (topic, types) in chosen.items():
        first[topic] = firsts.get(topic) or _first(bag, topic, types)
        if first[topic] is None:
            raise ProgroundError(
                f"has no messages of {topic}",
                where=bag.path,
                todo=f"choose with {option}; {_listed(_of_types(bag, *types))}",
            )
    return Topics(
        color,
        depth,
        chosen["color_info_topic"][0] if needs_cameras else None,
        chosen["depth_info_topic"][0] if needs_cameras else None,
        tuple(_of_types(bag, TF)),
        options.odometry_topic,
        first,
    )


def _of_types(bag: Bag, *types: str) -> list[str]:
    return sorted(topic for topic, its_type in bag.types.items() if its_type in types)


def _first(bag: Bag, topic: str, types: Iterable[str] = (IMAGE, COMPRESSED_IMAGE)) -> Any:
    """The first message of a topic; None where it has none, or is of another type."""
    if bag.types.get(topic, "") not in types:
        return None
    for _, _, data in bag.scan([topic]):
        return bag.decode(topic, data)
    return None


def _listed(topics: Iterable[str]) -> str:
    return f"there are: {', '.join(sorted(topics)) or 'none'}"


def _one_image(
    bag: Bag, firsts: dict[str, Any], is_kind: Callable[[Any], bool], kind: str, option: str
) -> str:
    """The only topic of a kind."""
    of_kind = {topic for topic, first in firsts.items() if is_kind(first)}
    found = {topic for topic in of_kind if _base(topic) == topic or _base(topic) not in of_kind}
    if colorful := {topic for topic in found if not is_grey(firsts[topic])}:
        found = colorful
    if len(found) == 1:
        return found.pop()
    if found:
        what = f"has several topics of {kind} images: {', '.join(sorted(found))}"
        raise ProgroundError(what, where=bag.path, todo=f"choose one with {option}")
    raise ProgroundError(
        f"has no topic of {kind} images",
        where=bag.path,
        todo=f"choose an image with {option}; {_listed(firsts)}",
    )


def _base(image_topic: str) -> str:
    """The name of an image's topic without that of its transport."""
    name, _, last = image_topic.rpartition("/")
    return name if last in TRANSPORTS else image_topic


def _info_of(image_topic: str) -> str:
    """Where ROS has the camera of an image: beside it."""
    return _base(image_topic).rpartition("/")[0] + "/camera_info"
