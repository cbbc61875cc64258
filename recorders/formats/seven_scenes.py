"""7-Scenes, also as 3DMatch and tsdf-fusion-python lay it out: sequences of a hand-held Kinect.

A sequence folder has frame-%06d.color.{png,jpg}, frame-%06d.depth.png (millimetres, 0 and 65535
where nothing was measured) and frame-%06d.pose.txt (world_from_camera of the depth camera; not
finite where tracking was lost, in the recordings of BundleFusion).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.reading.frame_files import Numbered, find_frames, pose_files
from recorders.reading.layout import holds

FRAME_RATE_HZ = 30
INVALID_DEPTH_MM = 65535


# The data set publishes the depth camera alone, and its colour is not registered. The colour
# camera here was measured on RedKitchen: pixels of one frame, carried by depth and poses into
# another up to 40 degrees away, should find their colour again. With the sensor's nominal 525
# pixels (left free: 523.9 and 526.6) and baseline of 25 mm, its turn and first radial term were
# fitted on one half of the sequence and judged on the other. PSNR of the colours found: 23.1 dB;
# without turn and radial term 22.8; at 539.5 and 538.8 pixels (structure from motion without
# distortion) 21.9, and with that on the wrong side 21.1; the pixel at the same place 19.3.
COLOR_CAMERA = Camera(640, 480, 525.0, 525.0, 320.0, 240.0, (-0.060, 0.0, 0.0, 0.0, 0.0))
DEPTH_CAMERA = Camera.from_integer_centres(640, 480, 585.0, 585.0, 320.0, 240.0)
COLOR_FROM_DEPTH_TURN_DEG = (0.20, 0.05, 0.23)
"""Rotation vector; the two halves of the sequence agree within 0.2 degrees about each axis."""
COLOR_FROM_DEPTH_M = (-0.025, 0.0, 0.0)


def kinect_calibration() -> Calibration:
    """The rig of the data set: depth as published, colour as measured."""
    color_from_depth = np.eye(4)
    turn = Rotation.from_rotvec(COLOR_FROM_DEPTH_TURN_DEG, degrees=True)
    color_from_depth[:3, :3] = turn.as_matrix()
    color_from_depth[:3, 3] = COLOR_FROM_DEPTH_M
    return Calibration(COLOR_CAMERA, DEPTH_CAMERA, np.linalg.inv(color_from_depth))


def recognise(source: Path) -> str | None:
    """Why a path looks like a sequence of 7-Scenes or a folder of them; None where it does not."""
    files = ("frame-*.depth.png", "frame-*.color.*", "frame-*.pose.txt")
    if holds(source, *files) or holds(source, *(f"seq-*/{file}" for file in files)):
        return "has frame-*.depth.png, frame-*.color.* and frame-*.pose.txt"
    return None


class SevenScenesSource:
    """One sequence; frames are in the order of their numbers, those without a pose left out."""

    name = "seven-scenes"

    def __init__(self, source: Path, *, calibration: Calibration | None = None) -> None:
        """Find the sequence's files and read its poses.

        Args:
            source: a sequence folder, or a scene's folder with one seq-* folder in it.
            calibration: the rig; by default the Kinect of the data set.

        Raises:
            ProgroundError: no such folder, several sequences, a file is missing or broken, or no
                frame has a pose.
        """
        self.calibration = calibration or kinect_calibration()
        self.label_names: dict[int, str] = {}
        self.warnings: tuple[str, ...] = ()
        folder = _sequence_folder(source)
        self._frames, lost = find_frames(
            Numbered(folder, r"frame-(\d+)\.depth\.png", "frame-{number:06d}.depth.png"),
            Numbered(folder, r"frame-(\d+)\.color\.(?:png|jpe?g)", "frame-{number:06d}.color.png"),
            pose_files(Numbered(folder, r"frame-(\d+)\.pose\.txt", "frame-{number:06d}.pose.txt")),
            rate_hz=FRAME_RATE_HZ,
            todo="give a sequence folder of 7-Scenes that was tracked, such as redkitchen/seq-01",
        )
        self.notes = {"frames without a pose": str(lost)}

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres, 0 where nothing was measured."""
        frame = self._frames[index].read(index, self.calibration)
        frame.depth[frame.depth == INVALID_DEPTH_MM] = 0
        return frame

    def ground_truth_mesh(self) -> bytes | None:
        """7-Scenes has none."""
        return None


def _sequence_folder(source: Path) -> Path:
    """The folder itself, or the one seq-* folder in it."""
    sequences = sorted(path for path in source.glob("seq-*") if path.is_dir())
    if not sequences:
        return source
    if len(sequences) > 1:
        names = ", ".join(path.name for path in sequences)
        raise ProgroundError(
            f"has several sequences ({names})", where=source, todo="give one of them"
        )
    return sequences[0]
