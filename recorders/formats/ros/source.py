"""What is recorded of a bag, whichever ROS it is of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from proground_log.camera import Calibration
from proground_log.frame import SensorFrame
from recorders.formats.ros.recording import RosRecording
from recorders.formats.ros.topics import Bag, TopicOptions


class RosBagSource(ABC):
    """One bag; frames are in the order of the depth images' stamps.

    ROS 1 and ROS 2 differ in `open_bag` alone.
    """

    name: str

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
            source: the bag.
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
            self.open_bag(source),
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

    @staticmethod
    @abstractmethod
    def open_bag(source: Path) -> Bag:
        """The bag at a path; raises a ProgroundError where there is none."""

    def __len__(self) -> int:
        return len(self._recording)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres or float32 in metres."""
        return self._recording.frame(index)

    def ground_truth_mesh(self) -> bytes | None:
        """Bags have none."""
        return None
