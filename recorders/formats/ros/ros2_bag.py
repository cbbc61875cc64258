"""ROS 2 bags in MCAP: an .mcap file, or rosbag2's folder with metadata.yaml and .mcap files.

Colour and depth are sensor_msgs Images or CompressedImages, cameras CameraInfos beside them (P of
rectified images, whose names have "rect" in them; else K and D), poses come from tf or odometry.
"""

from __future__ import annotations

import re
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from recorders.formats.ros.mcap_bag import McapBag, read_summary, ros_types
from recorders.formats.ros.messages import COMPRESSED_IMAGE, IMAGE
from recorders.formats.ros.source import RosBagSource
from recorders.formats.ros.topics import Bag
from recorders.reading.association import read_text

CONVERT = "convert it to MCAP without that: `ros2 bag convert`"


class Ros2BagSource(RosBagSource):
    """A bag of ROS 2: an .mcap file, or the folder of several."""

    name = "ros2-bag"

    @staticmethod
    def open_bag(source: Path) -> Bag:
        """The bag's MCAP files; raises a ProgroundError where one is missing or is none."""
        return McapBag(source, _files(source))


def recognise(source: Path) -> str | None:
    """What makes a path look like a ROS 2 bag, which a log of ours is too; None otherwise."""
    if source.is_dir():
        text = read_text(source / "metadata.yaml")
        return "has rosbag2's metadata.yaml" if "rosbag2_bagfile_information" in text else None
    if source.suffix != ".mcap":
        return None
    has_images = {IMAGE, COMPRESSED_IMAGE} & set(ros_types(read_summary(source)).values())
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
