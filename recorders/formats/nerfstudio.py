"""nerfstudio: photographs with poses and depth images, listed in transforms.json.

The file has the camera (see `transforms_camera`) and `frames`: `file_path`, `depth_file_path`
(16-bit PNG, or .npy, times a unit) and `transform_matrix`, world_from_camera with OpenGL's axes.
Positions are in units that `applied_scale`, where it is there, made of those of the depth.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.nerfstudio_camera import read_camera
from recorders.reading.association import frame_stamp_ns
from recorders.reading.axes import opencv_from_opengl
from recorders.reading.images import read_color, read_depth, read_encoded
from recorders.reading.json_file import read_json
from recorders.reading.layout import holds
from recorders.reading.natural_order import natural_key
from recorders.reading.npy import read_npy_image

FILE_NAME = "transforms.json"
FRAME_RATE_HZ = 30
MILLIMETRE_M = 1e-3
IMAGE_SUFFIXES = ("", ".png", ".jpg", ".jpeg")
"""Blender's files leave the suffix out."""


def recognise(source: Path) -> str | None:
    """Why a path looks like a nerfstudio data set or its transforms*.json; None if it does not."""
    if holds(source, FILE_NAME):
        return f"has {FILE_NAME}"
    if re.fullmatch(r"transforms.*\.json", source.name) and holds(source.parent, source.name):
        return "is a transforms.json"
    return None


@dataclass(frozen=True)
class _Frame:
    """A frame with depth and a pose: its place in the order of names, and its entries."""

    place: int
    color: Path
    depth: Path
    world_from_camera: np.ndarray
    params: dict[str, Any]
    where: str


class NerfstudioSource:
    """One data set; frames are in the order of their file names, numbers in them as numbers."""

    name = "nerfstudio"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        depth_unit_scale_factor: float | None = None,
    ) -> None:
        """Read transforms.json and find its files.

        Args:
            source: the folder with transforms.json, or the file.
            calibration: the rig; by default as transforms.json has it, for each frame.
            depth_unit_scale_factor: metres of a unit of the depth images; by default what
                transforms.json says, else 0.001.

        Raises:
            ProgroundError: a file is missing or broken, or no frame has depth and a pose.
        """
        path = source / FILE_NAME if source.is_dir() else source
        content = read_json(path)
        if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
            raise ProgroundError(
                "has no list of frames", where=path, todo=f"give the {FILE_NAME} of a data set"
            )
        given = depth_unit_scale_factor
        if given is None:
            given = content.get("depth_unit_scale_factor", MILLIMETRE_M)
        self._depth_unit_m = _positive(given, "depth_unit_scale_factor", where=path)
        scale = _positive(content.get("applied_scale", 1.0), "applied_scale", where=path)
        self._frames, self.notes = _find_frames(path, content, scale)
        first = self._frames[0]
        color = read_encoded(first.color)
        self._color_size = (color.width, color.height)
        self._depth_size = _depth_size(first.depth)
        self._has_given_calibration = calibration is not None
        self.calibration = calibration or self._calibration(first)
        for frame in self._frames:
            self._calibration(frame)
        self.label_names: dict[int, str] = {}
        self.warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres or float32 in metres."""
        files = self._frames[index]
        cameras = self.calibration if self._has_given_calibration else self._calibration(files)
        color = read_color(files.color, cameras.color)
        stamp_ns = frame_stamp_ns(files.place, FRAME_RATE_HZ)
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=self._read_depth(files.depth, cameras.depth),
            world_from_camera=files.world_from_camera,
            calibration=None if cameras == self.calibration else cameras,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """nerfstudio has none."""
        return None

    def _calibration(self, frame: _Frame) -> Calibration:
        """The frame's cameras; the depth image shows what the colour image does, at its size."""
        color = read_camera(frame.params, self._color_size, where=frame.where)
        return Calibration(color, color.resized(*self._depth_size), np.eye(4))

    def _read_depth(self, path: Path, camera: Camera) -> np.ndarray:
        if path.suffix != ".npy":
            depth = read_depth(path, camera)
            if self._depth_unit_m == MILLIMETRE_M:
                return depth
            return np.multiply(depth, self._depth_unit_m, dtype=np.float32)
        image = read_npy_image(path)
        if image.shape != (camera.height, camera.width):
            raise ProgroundError(
                f"is {image.shape[1]}x{image.shape[0]}, but the others are "
                f"{camera.width}x{camera.height}",
                where=path,
                todo="bring the depth images to one size",
            )
        measured = np.isfinite(image) & (image > 0)
        depth_m = np.multiply(image, self._depth_unit_m, dtype=np.float32)
        return np.where(measured, depth_m, np.float32(0))


def _positive(value: Any, name: str, *, where: object) -> float:
    """A finite number above 0; raises a ProgroundError for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = 0.0
    if not 0 < number < math.inf:
        raise ProgroundError(
            f"{name} is {value}", where=where, todo="it has to be a number above 0"
        )
    return number


def _depth_size(path: Path) -> tuple[int, int]:
    """Width and height of a depth image."""
    if path.suffix == ".npy":
        height, width = read_npy_image(path).shape
        return width, height
    image = read_encoded(path)
    return image.width, image.height


def _find_frames(
    path: Path, content: Mapping[str, Any], scale: float
) -> tuple[list[_Frame], dict[str, str]]:
    """The frames that have depth and a pose, and notes on those left out."""
    files = _Files(path.parent)
    common = {key: value for key, value in content.items() if key != "frames"}
    entries = []
    for number, entry in enumerate(content["frames"]):
        where = f"{path}, frame {number}"
        name = entry.get("file_path") if isinstance(entry, dict) else None
        if not isinstance(name, str):
            raise ProgroundError("has no file_path", where=where, todo="mend or remove the frame")
        entries.append((natural_key(name), number, name, entry, where))
    frames, without_depth, without_pose = [], 0, 0
    for place, (_, _, name, entry, where) in enumerate(sorted(entries, key=lambda each: each[:2])):
        pose = _read_pose(entry.get("transform_matrix"), scale, where=where)
        depth = entry.get("depth_file_path")
        without_depth += depth is None
        without_pose += depth is not None and pose is None
        if depth is None or pose is None:
            continue
        color_path = files.find(name, IMAGE_SUFFIXES, where=where)
        depth_path = files.find(depth, ("",), where=where)
        # As nerfstudio has it, what the file says for all goes before what a frame says.
        frames.append(_Frame(place, color_path, depth_path, pose, {**entry, **common}, where))
    if not frames:
        raise ProgroundError(
            f"none of {len(entries)} frames has a depth_file_path and a pose",
            where=path,
            todo="add depth images; where they come from COLMAP, record its folder as `colmap`",
        )
    notes = {
        "frames without depth": str(without_depth),
        "frames without a pose": str(without_pose),
        "times": f"none in the source: frames in the order of names, {FRAME_RATE_HZ} a second",
    }
    if "applied_transform" in content:
        notes["world axes"] = "those of transforms.json; applied_transform is not undone"
    if scale != 1:
        notes["applied_scale"] = f"undone: positions are divided by {scale:g}"
    return frames, notes


def _read_pose(matrix: Any, scale: float, *, where: object) -> np.ndarray | None:
    """world_from_camera [4, 4] in metres, our axes; None where there is none or it is not finite.

    Raises:
        ProgroundError: it is no rigid transform.
    """
    if matrix is None:
        return None
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ProgroundError(
            "transform_matrix is not a matrix of numbers",
            where=where,
            todo="mend or remove the frame",
        ) from error
    if not np.isfinite(pose).all():
        return None
    pose = require_rigid(pose, where=where)
    pose[:3, 3] /= scale
    return opencv_from_opengl(pose)


class _Files:
    """The files below a folder, by the paths that transforms.json has; each folder listed once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: dict[PurePosixPath, set[str]] = {}

    def find(self, text: Any, suffixes: tuple[str, ...], *, where: object) -> Path:
        """The file, its name with the first suffix that makes it one that is there.

        Raises:
            ProgroundError: the path is none, leads out of the folder, or there is no such file.
        """
        relative = PurePosixPath(text) if isinstance(text, str) else PurePosixPath()
        if not relative.name or relative.is_absolute() or ".." in relative.parts or "://" in text:
            raise ProgroundError(
                f"the path {text!r} leads out of the data set",
                where=where,
                todo=f"give paths relative to the folder of {FILE_NAME}, without `..`",
            )
        folder = self._folder
        for part in relative.parent.parts:
            folder = folder / part
        if relative.parent not in self._names:
            try:
                self._names[relative.parent] = {path.name for path in folder.iterdir()}
            except (OSError, ValueError):  # No such folder, or a text that can be none.
                self._names[relative.parent] = set()
        for suffix in suffixes:
            if relative.name + suffix in self._names[relative.parent]:
                return folder / (relative.name + suffix)
        raise ProgroundError(
            f"there is no file {text!r}",
            where=where,
            todo="complete the data set, or remove the frame",
        )
