"""Replica as Semantic-NeRF and vMAP rendered it, with a class and an instance image a frame.

A sequence folder has rgb/rgb_%d.png, depth/depth_%d.png (millimetres), traj_w_c.txt (16 numbers a
line, world_from_camera), semantic_class/semantic_class_%d.png and
semantic_instance/semantic_instance_%d.png; numbers are not padded. info_semantic.json lies with
the sequence or its scene.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.replica_labels import (
    INFO_NAME,
    find_mesh,
    read_instance_classes,
    read_label_names,
    truth_images,
)
from recorders.reading.frame_files import FrameFiles, Numbered, find_frames, pose_lines
from recorders.reading.images import read_encoded
from recorders.reading.layout import holds

FRAME_RATE_HZ = 30
SIZES = {"vMAP": (1200, 680), "Semantic-NeRF": (640, 480)}


def recognise(source: Path) -> str | None:
    """Why a path looks like a sequence in this layout; None where it does not."""
    if holds(source, "traj_w_c.txt", "rgb/rgb_*.png", "depth/depth_*.png"):
        return "has traj_w_c.txt, rgb/rgb_*.png and depth/depth_*.png"
    return None


class ReplicaSemanticSource:
    """One sequence; frames are in the order of their numbers."""

    name = "replica-semantic"

    def __init__(self, source: Path, *, calibration: Calibration | None = None) -> None:
        """Find the sequence's files.

        Args:
            source: the sequence's folder, such as room_0/imap/00 or room_0/Sequence_1.
            calibration: the rig; by default the renderers' camera, known by the images' size.

        Raises:
            ProgroundError: a file is missing or broken, there are no frames, or the images have
                another size than the renderers'.
        """
        self._frames, _ = find_frames(
            Numbered(source / "depth", r"depth_(\d+)\.png", "depth_{number}.png"),
            Numbered(source / "rgb", r"rgb_(\d+)\.png", "rgb_{number}.png"),
            pose_lines(source / "traj_w_c.txt"),
            rate_hz=FRAME_RATE_HZ,
            **truth_images(source),
            todo="give a rendering of Replica",
        )
        first = self._frames[0]
        self.calibration = calibration or _calibration_by_size(first.color)
        self._mesh, self.notes = find_mesh(source)
        self.warnings: tuple[str, ...] = ()
        self.label_names: dict[int, str] = {}
        self._class_of_instance: np.ndarray | None = None
        if first.labels is not None or first.instances is not None:
            info = _find_info(source)
            self.label_names = read_label_names(info)
            if first.labels is None:
                self._class_of_instance = read_instance_classes(info)

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres."""
        files = self._frames[index]
        frame = files.read(index, self.calibration)
        if frame.instances is None or self._class_of_instance is None:
            return frame
        labels = _classes_of(frame.instances, self._class_of_instance, files)
        return replace(frame, labels=labels)

    def ground_truth_mesh(self) -> bytes | None:
        """The bytes of *mesh_semantic*.ply, where there is one and its vertices have labels."""
        return self._mesh.read_bytes() if self._mesh else None


def _calibration_by_size(color: Path) -> Calibration:
    """Both renderers' cameras are 90 degrees wide and look through the middle of the image."""
    image = read_encoded(color)
    width, height = image.width, image.height
    if (width, height) not in SIZES.values():
        known = " and ".join(f"{w}x{h} ({name})" for name, (w, h) in SIZES.items())
        raise ProgroundError(
            f"is {width}x{height}: only the cameras of {known} are known",
            where=color,
            todo="pass the calibration of these images",
        )
    return Calibration.registered(
        Camera(width, height, width / 2, width / 2, width / 2, height / 2)
    )


def _find_info(source: Path) -> Path:
    """Where info_semantic.json lies: in Semantic-NeRF's and vMAP's folders or with the sequence."""
    above, scene = source.parent, source.parent.parent
    places = (source, above, scene, above / "habitat", scene / "habitat")
    for folder in (*places, scene / "semantic_info" / above.name):
        if (folder / INFO_NAME).is_file():
            return folder / INFO_NAME
    raise ProgroundError(
        "is missing, though there are class or instance images",
        where=source / INFO_NAME,
        todo="copy it there from the habitat/ folder of the scene in Replica",
    )


def _classes_of(instances: np.ndarray, class_of: np.ndarray, files: FrameFiles) -> np.ndarray:
    """The class image, uint16 [H, W], of an instance image."""
    if instances.max() >= len(class_of):
        raise ProgroundError(
            f"has instance {instances.max()}, but {INFO_NAME} tells the classes of "
            f"{len(class_of)} from 0",
            where=files.instances,
            todo=f"use the {INFO_NAME} of this scene",
        )
    return class_of[instances]
