"""One moment of a recording: as the sensors gave it, and registered for the mapper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.encoded_image import is_whole
from proground_log.errors import ProgroundError
from proground_log.regions import Regions

NO_REGION = -1
"""In place of a region: perception found nothing at the pixel."""
AT_EDGE = -2
"""In place of a region: beside a depth jump, where nobody knows which side a pixel is of."""


def evenly(count: int, most: int) -> list[int]:
    """At most so many of the numbers 0 to count - 1, evenly spaced, rising.

    Example:
        >>> evenly(10, 4)
        [0, 3, 6, 9]
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()


@dataclass(frozen=True)
class SensorFrame:
    """What the sensors gave at one time, bytes untouched: what a log keeps.

    Args:
        index: number of the frame in its log, from 0.
        stamp_ns: time of the depth image; the frame's time.
        color_stamp_ns: the colour image's own time.
        color: the colour image, encoded as in the source.
        color_format: "jpeg" or "png".
        depth: [H, W], uint16 in millimetres or float32 in metres; 0 where nothing was measured.
        world_from_camera: pose of the depth camera, float64 [4, 4].
        labels: class of each pixel of the colour camera, uint16 [H, W], 0 = none; where known.
        instances: number of the thing that each pixel belongs to, likewise.
        calibration: the cameras of this frame, where they are not those of the recording: phones
            refocus. Where they sit stays the same.
        regions: what perception found in the colour image; None before `pglog perceive`.
    """

    index: int
    stamp_ns: int
    color_stamp_ns: int
    color: bytes
    color_format: str
    depth: np.ndarray
    world_from_camera: np.ndarray
    labels: np.ndarray | None = None
    instances: np.ndarray | None = None
    calibration: Calibration | None = None
    regions: Regions | None = None

    @property
    def depth_m(self) -> np.ndarray:
        """The depth image in metres along z, float32 [H, W]."""
        if self.depth.dtype == np.uint16:
            return self.depth.astype(np.float32) * np.float32(1e-3)
        return self.depth

    def decode_color(self) -> np.ndarray:
        """The colour image, uint8 [H, W, 3] RGB; raises a ProgroundError where it is broken."""
        whole = is_whole(self.color, self.color_format)
        encoded = np.frombuffer(self.color, np.uint8)
        image = cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB) if whole else None
        if image is None:
            what = "cannot be decoded" if whole else "is cut short or damaged"
            raise ProgroundError(
                f"the {self.color_format} image {what}",
                where=f"frame {self.index}",
                todo="record the log again, or leave the frame out",
            )
        return np.asarray(image, dtype=np.uint8)


@dataclass(frozen=True)
class Frame:
    """A registered frame: colour and labels looked up at each pixel of the depth camera.

    Args:
        index: number of the frame in its log.
        stamp_ns: time of the frame.
        camera: the depth camera, without distortion.
        world_from_camera: its pose, float64 [4, 4].
        depth_m: float32 [H, W] metres along z, 0 where nothing was measured.
        color: uint8 [H, W, 3] RGB.
        color_valid: bool [H, W], where the colour camera saw the pixel.
        labels: uint16 [H, W], 0 = none; None where the log has no ground truth.
        regions: what perception found; None where the log has no regions.
        region_of: int32 [H, W], number of the region that the pixel belongs to, or
            `NO_REGION`, or `AT_EDGE` at depth jumps; None where the log has no regions.
    """

    index: int
    stamp_ns: int
    camera: Camera
    world_from_camera: np.ndarray
    depth_m: np.ndarray
    color: np.ndarray
    color_valid: np.ndarray
    labels: np.ndarray | None
    regions: Regions | None = None
    region_of: np.ndarray | None = None


@dataclass(frozen=True)
class Selection:
    """Which frames to take: every `stride`-th from `start` up to, not including, `stop`."""

    start: int = 0
    """First frame."""
    stop: int | None = None
    """Frame to stop before."""
    stride: int = 1
    """Take every so many-th frame."""

    def of(self, count: int) -> Sequence[int]:
        """The selected frame numbers of a recording of `count` frames."""
        stop = count if self.stop is None else min(self.stop, count)
        chosen = range(self.start, stop, self.stride) if self._is_sound() else range(0)
        if not chosen:
            raise ProgroundError(
                f"start {self.start}, stop {self.stop}, stride {self.stride} select no frame",
                where=f"a recording of {count} frames",
                todo=f"select frames between 0 and {count - 1}, with a stride of 1 or more",
            )
        return chosen

    def _is_sound(self) -> bool:
        return self.start >= 0 and self.stride >= 1
