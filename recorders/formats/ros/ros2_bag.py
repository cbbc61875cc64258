"""ROS 2 bags in MCAP: an .mcap file, or rosbag2's folder with metadata.yaml and .mcap files.

Colour and depth are sensor_msgs Images or CompressedImages, cameras CameraInfos beside them (P of
rectified images, whose names have "rect" in them; else K and D), poses come from tf or odometry.
"""

from __future__ import annotations

import re
from pathlib import Path

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.frame import SensorFrame
from recorders.formats.ros.mcap_bag import McapBag, read_summary, ros_types
from recorders.formats.ros.messages import COMPRESSED_IMAGE, IMAGE
from recorders.formats.ros.recording import RosRecording
from recorders.formats.ros.topics import TopicOptions
from recorders.reading.association import read_text

CONVERT = "convert it to MCAP without that: `ros2 bag convert`"


class Ros2BagSource:
    """One bag; frames are in the order of the depth images' stamps."""

    name = "ros2-bag"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        color_topic: str | None = None,
        depth_topic: str | None = None,
        color_info_topic: str | None = None,
        depth_info_topic: str | None = None,
        odometry_topic: str | None = None,
        world_frame: str | None = None,
        max_time_difference_s: float = 0.02,
        max_pose_gap_s: float = 0.5,
    ) -> None:
        """Pass over the bag once: choose topics, pair the images, find the poses.

        Args:
            source: the .mcap file, or the folder.
            calibration: the rig; by default from the CameraInfos and tf.
            color_topic, depth_topic: images; by default the only ones of their kind.
            color_info_topic, depth_info_topic: cameras; by default camera_info beside the images.
            odometry_topic: Odometry or PoseStamped to take poses from, rather than tf. Of a
                PoseStamped, which names no frame, it is assumed to be the depth camera's.
            world_frame: the world; by default map, odom, world or the root of the tree.
            max_time_difference_s: the largest time between the two images of a pair.
            max_pose_gap_s: transforms further apart are not interpolated between.

        Raises:
            ProgroundError: no bag, a damaged one, a topic or transform that is missing or
                ambiguous, or no frame has a pose.
        """
        self._recording = RosRecording(
            McapBag(source, _files(source)),
            calibration,
            TopicOptions(
                color_topic, depth_topic, color_info_topic, depth_info_topic, odometry_topic
            ),
            world_frame=world_frame,
            max_time_difference_s=max_time_difference_s,
            max_pose_gap_s=max_pose_gap_s,
        )
        self.calibration = self._recording.calibration
        self.label_names: dict[int, str] = {}
        self.notes, self.warnings = self._recording.notes, self._recording.warnings

    def __len__(self) -> int:
        return len(self._recording)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres or float32 in metres."""
        return self._recording.frame(index)

    def ground_truth_mesh(self) -> bytes | None:
        """Bags have none."""
        return None


def recognise(source: Path) -> str | None:
    """What makes a path look like a ROS 2 bag, which a log of ours is too; None otherwise."""
    try:
        if source.is_dir():
            text = read_text(source / "metadata.yaml")
            return "has rosbag2's metadata.yaml" if "rosbag2_bagfile_information" in text else None
        if source.suffix != ".mcap":
            return None
        summary = read_summary(source)
    except (ProgroundError, OSError):
        return None
    has_images = {IMAGE, COMPRESSED_IMAGE} & set(ros_types(summary).values())
    return "is MCAP with ROS 2 images" if has_images else None


def _files(source: Path) -> list[Path]:
    """The MCAP files of a bag, all that its metadata.yaml lists."""
    if not source.is_dir():
        if source.suffix == ".db3":
            raise ProgroundError("is SQLite, not MCAP", where=source, todo=CONVERT)
        return [require_file(source)]
    metadata = source / "metadata.yaml"
    if not metadata.is_file():
        raise ProgroundError(
            "has no metadata.yaml",
            where=source,
            todo=f"mend the bag with `ros2 bag reindex {source}`, or give an .mcap file",
        )
    text = read_text(metadata)
    if re.search(
        r"^\s*compression_mode:\s*\W?(?:FILE|MESSAGE)", text, re.IGNORECASE | re.MULTILINE
    ):
        raise ProgroundError("rosbag2 compressed the bag once more", where=source, todo=CONVERT)
    # The two fields that matter are each a list of plain names; no more YAML than that.
    listed = re.findall(
        r"^\s*-\s*['\"]?(?:[^'\"\n]*/)?([^/'\"\s]+\.(?:mcap|db3))\b", text, re.MULTILINE
    )
    if not listed or any(name.endswith(".db3") for name in listed):
        raise ProgroundError("has no MCAP files", where=metadata, todo=CONVERT)
    return [require_file(source / name) for name in dict.fromkeys(listed)]
