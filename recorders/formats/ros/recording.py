"""The frames of a bag: images paired by their stamps, poses from the transforms between frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.log.messages import without_stamp
from recorders.formats.ros.messages import camera, color_image, depth_image, frame_id
from recorders.formats.ros.tf_tree import TfTree, Transforms
from recorders.formats.ros.topics import (
    Bag,
    Key,
    TopicOptions,
    Topics,
    choose_topics,
    is_rectified,
    is_static,
)
from recorders.reading.association import SECOND_NS, associate, span_ns
from recorders.reading.images import EncodedImage

WORLD_FRAMES = ("map", "odom", "world")
"""What ROS calls the world (REP 105), the one that drifts least first."""


@dataclass
class _Scan:
    """What one pass over a bag finds: images by stamp, transforms, cameras that change."""

    images: dict[str, dict[int, Key]]
    transforms: Transforms
    odometry: Transforms
    repeated: int = 0
    changing: tuple[str, ...] = ()


class RosRecording:
    """A bag as frames: each depth image with the closest colour image and the pose at its time.

    Args:
        bag: the bag.
        calibration: the rig; by default of the CameraInfos and the transform between the cameras.
        options: topics that are not to be found but are known.
        world_frame: the world; by default the first of WORLD_FRAMES, or the root of the tree.
        max_time_difference_s: the largest time between the two images of a pair.
        max_pose_gap_s: two transforms further apart are not interpolated between.

    Raises:
        ProgroundError: a topic or transform is missing or ambiguous, or no pair has a pose.
    """

    def __init__(
        self,
        bag: Bag,
        calibration: Calibration | None,
        options: TopicOptions,
        *,
        world_frame: str | None,
        max_time_difference_s: float,
        max_pose_gap_s: float,
    ) -> None:
        limit_ns = span_ns(max_time_difference_s, name="max_time_difference_s")
        gap_ns = span_ns(max_pose_gap_s, name="max_pose_gap_s")
        self._bag = bag
        self._topics = topics = choose_topics(bag, options, needs_cameras=calibration is None)
        color, depth = topics.first[topics.color], topics.first[topics.depth]
        color_frame, depth_frame = frame_id(color), frame_id(depth)
        scan = _scanned(bag, topics, depth_frame)
        where = str(bag.path)
        tree = TfTree(scan.transforms.edges(gap_ns, where=where), where=where)
        self.calibration = calibration or Calibration(
            self._camera(topics.color_info, topics.color),
            self._camera(topics.depth_info, topics.depth),
            self._mount(tree, depth_frame, color_frame),
        )
        # Tells at once what could not be read: encodings, and sizes that are not the cameras'.
        self._color(color, "the first image")
        self._depth(depth, "the first image")
        world = world_frame and world_frame.removeprefix("/")
        for edge in scan.odometry.edges(gap_ns, where=where):
            tree, world = tree.placed(edge), world or edge.parent
        world = world or _world(tree, depth_frame)
        path = tree.path(world, depth_frame)
        depths, colors = (
            sorted(scan.images[name].items()) for name in (topics.depth, topics.color)
        )
        pairs = [
            (depths[i], colors[j])
            for i, j in associate([t for t, _ in depths], [t for t, _ in colors], limit_ns)
        ]
        covered = path.covers([stamp_ns for (stamp_ns, _), _ in pairs])
        self._frames = [pairs[i] for i in np.flatnonzero(covered)]
        if not self._frames:
            raise ProgroundError(
                f"no frame: {len(depths)} depth and {len(colors)} colour images make "
                f"{len(pairs)} pairs within {max_time_difference_s} s, none with a pose of "
                f"{depth_frame!r} in {world!r}",
                where=where,
                todo="check the times of images and transforms, or choose another world_frame",
            )
        self._poses = path.at([stamp_ns for (stamp_ns, _), _ in self._frames])
        self.notes = {
            "colour": topics.color,
            "depth": topics.depth,
            "poses": f"of {depth_frame} in {world}, by {topics.odometry or 'tf'}",
            "images without a partner": str(len(depths) - len(pairs)),
            "images with the time of another": str(scan.repeated),
            "frames without a pose": str(len(pairs) - len(self._frames)),
            "transforms that are none": str(scan.transforms.left_out + scan.odometry.left_out),
        }
        if color_frame == depth_frame and calibration is None:
            self.notes["registered"] = f"colour and depth are both in the frame {color_frame}"
        self.warnings = tuple(
            f"the camera of {topic} changes on the way; its first state was taken"
            for topic in scan.changing
        )
        if path.is_static:
            self.warnings += (f"nothing moves between {world} and {depth_frame}",)

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres or float32 in metres."""
        (stamp_ns, depth_key), (color_stamp_ns, color_key) = self._frames[index]
        color = self._color(
            self._bag.read(self._topics.color, color_key), f"at {color_stamp_ns} ns"
        )
        depth = self._depth(self._bag.read(self._topics.depth, depth_key), f"at {stamp_ns} ns")
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=color_stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=depth,
            world_from_camera=self._poses[index],
        )

    def _color(self, message: Any, which: str) -> EncodedImage:
        where, known = f"{self._bag.path}, {self._topics.color}, {which}", self.calibration.color
        image = color_image(message, where=where)
        if (image.width, image.height) != (known.width, known.height):
            raise ProgroundError(
                f"the image is {image.width}x{image.height}, its camera "
                f"{known.width}x{known.height}",
                where=where,
                todo="name the right color_info_topic, or pass the calibration",
            )
        return image

    def _depth(self, message: Any, which: str) -> np.ndarray:
        where = f"{self._bag.path}, {self._topics.depth}, {which}"
        return depth_image(message, self.calibration.depth, where=where)

    def _camera(self, info_topic: str | None, image_topic: str) -> Any:
        info = self._topics.first[str(info_topic)]
        where = f"{self._bag.path}, {info_topic}"
        return camera(info, is_rectified=is_rectified(image_topic), where=where)

    def _mount(self, tree: TfTree, depth_frame: str, color_frame: str) -> np.ndarray:
        """depth_from_color, [4, 4]."""
        path = tree.path(depth_frame, color_frame)
        if not path.is_static:
            raise ProgroundError(
                f"the colour camera ({color_frame}) moves against the depth camera ({depth_frame})",
                where=self._bag.path,
                todo="choose two cameras of one rig, or pass the calibration",
            )
        return path.at([0])[0]


def _world(tree: TfTree, depth_frame: str) -> str:
    """The frame to call the world."""
    for name in WORLD_FRAMES:
        if tree.connects(name, depth_frame):
            return name
    return tree.root_above(depth_frame)


def _scanned(bag: Bag, topics: Topics, depth_frame: str) -> _Scan:
    """Pass over the bag once; of its images only the times are read."""
    images = {topics.color: dict[int, Key](), topics.depth: dict[int, Key]()}
    scan = _Scan(images, Transforms(), Transforms())
    infos: dict[str, set[bytes]] = {}
    wanted = {*topics.first, *topics.tf}
    for topic, key, data in bag.scan(sorted(wanted)):
        if topic in images:
            if images[topic].setdefault(bag.stamp_ns(topic, data), key) != key:
                scan.repeated += 1
        elif topic == topics.odometry:
            _add_pose(
                scan.odometry, bag.decode(topic, data), bag.stamp_ns(topic, data), depth_frame
            )
        elif topic in topics.tf:
            for parent, child, stamp_ns, transform in _transforms(bag.decode(topic, data)):
                scan.transforms.add(parent, child, stamp_ns, transform, is_static=is_static(topic))
        elif len(infos.setdefault(topic, set())) < 2:
            infos[topic].add(without_stamp(data))
    scan.changing = tuple(topic for topic, contents in sorted(infos.items()) if len(contents) > 1)
    return scan


def _transforms(message: Any) -> Iterator[tuple[str, str, int, Any]]:
    """Parent, child, time and transform of each in a TFMessage."""
    for each in message.transforms:
        stamp = each.header.stamp
        stamp_ns = int(stamp.sec) * SECOND_NS + int(stamp.nanosec)
        yield each.header.frame_id, each.child_frame_id, stamp_ns, each.transform


def _add_pose(odometry: Transforms, message: Any, stamp_ns: int, depth_frame: str) -> None:
    """Add an Odometry, or a PoseStamped, which does not say of what: of the depth camera, then."""
    is_odometry = hasattr(message.pose, "pose")
    child = message.child_frame_id if is_odometry else depth_frame
    pose = message.pose.pose if is_odometry else message.pose
    odometry.add(message.header.frame_id, child or depth_frame, stamp_ns, pose)
