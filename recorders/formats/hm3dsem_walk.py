"""Walks through Habitat-Matterport 3D Semantics, as HOV-SG renders them.

A walk's folder has rgb/, depth/ (millimetres, 0 where there is nothing) and pose/ with files
<scene>_%06d.{png,txt}: 16 numbers, world_from_camera with OpenGL's axes; semantic/*.npy has the
number of the thing at each pixel, which the data set's <scene>.semantic.txt names.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import nearest_above
from proground_log.frame import SensorFrame
from recorders.reading.association import frame_stamp_ns, is_tracked, parse_matrix, read_text
from recorders.reading.axes import opencv_from_opengl
from recorders.reading.images import (
    numbered_files,
    read_color,
    read_depth,
    read_encoded,
    require_size,
)
from recorders.reading.layout import holds
from recorders.reading.npy import read_npy_image

FRAME_RATE_HZ = 5
"""A frame is a step of 0.2 m or a turn of 5 degrees: with this rate, at a walking pace."""
LARGEST_NUMBER = 65535
FIRST_LINE = "HM3D Semantic Annotations"
_POSES = "[0-9A-Za-z]" * 11 + "_" + "[0-9]" * 6 + ".txt"
"""The data set's scenes have names of 11 characters."""


@dataclass(frozen=True)
class _Files:
    """Where one frame is: its number, its images, and its pose, float64 [4, 4], our axes."""

    number: int
    color: Path
    depth: Path
    instances: Path | None
    world_from_camera: np.ndarray


def recognise(source: Path) -> str | None:
    """Why the path looks like a walk, or None."""
    if holds(source, "rgb/*_*", "depth/*_*.png", f"pose/{_POSES}"):
        return "has rgb, depth and pose with files <scene>_<number>"
    return None


class Hm3dsemWalkSource:
    """One walk; frames are in the order of their numbers."""

    name = "hm3dsem-walk"

    def __init__(self, source: Path, *, calibration: Calibration | None = None) -> None:
        """Find the walk's files and read its poses.

        Args:
            source: the walk's folder; the classes' names, <scene>.semantic.txt, lie there or in
                a folder above.
            calibration: the rig; by default one camera that sees 90 degrees across.

        Raises:
            ProgroundError: a file is missing or broken, or no frame has a pose.
        """
        self._frames, lost = _find_frames(source)
        self.calibration = calibration or _registered(self._frames[0].color)
        self.notes = {"frames without a pose": str(lost)}
        self.warnings: tuple[str, ...] = ()
        self.label_names: dict[int, str] = {}
        self._label_of: np.ndarray | None = None
        names_file = f"{_scene(self._frames[0].depth)}.semantic.txt"
        names_path = nearest_above(source, names_file)
        if self._frames[0].instances is None:
            self.notes["true classes"] = "none: there is no folder semantic"
        elif names_path is None:
            self.notes["true classes"] = f"none: there is no {names_file} here or above"
        else:
            self.label_names, self._label_of = _read_classes(names_path)

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres."""
        files, camera = self._frames[index], self.calibration.color
        color = read_color(files.color, camera)
        instances = _read_instances(files.instances, camera) if files.instances else None
        labels = None
        if instances is not None and self._label_of is not None:
            labels = self._label_of[instances]
        stamp_ns = frame_stamp_ns(files.number, FRAME_RATE_HZ)
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=read_depth(files.depth, self.calibration.depth),
            world_from_camera=files.world_from_camera,
            labels=labels,
            instances=instances,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """A walk has none."""
        return None


def _registered(color: Path) -> Calibration:
    """The camera of the renderer, for images of this one's size."""
    image = read_encoded(color)
    half_width, half_height = image.width / 2, image.height / 2
    camera = Camera(image.width, image.height, half_width, half_width, half_width, half_height)
    return Calibration.registered(camera)


def _scene(path: Path) -> str:
    """The scene's name in that of an image."""
    return re.sub(r"[_-]\d+$", "", path.stem)


def _find_frames(source: Path) -> tuple[list[_Files], int]:
    """The frames that have a pose, each of them complete, and the number of the others."""
    depths = numbered_files(source / "depth", r".+[_-](\d+)\.png")
    if not depths:
        raise ProgroundError(
            "has no images such as <scene>_000000.png",
            where=source / "depth",
            todo="give the folder of a walk as HOV-SG's script renders it",
        )
    colors = numbered_files(source / "rgb", r".+[_-](\d+)\.(?:png|jpe?g)")
    poses = numbered_files(source / "pose", r".+[_-](\d+)\.txt")
    has_truth = (source / "semantic").is_dir()
    things = numbered_files(source / "semantic", r".+[_-](\d+)\.npy") if has_truth else {}
    frames = []
    for number, depth in depths.items():
        for missing, path in (
            (number not in colors, source / "rgb" / depth.name),
            (number not in poses, source / "pose" / f"{depth.stem}.txt"),
            (has_truth and number not in things, source / "semantic" / f"{depth.stem}.npy"),
        ):
            if missing:
                raise ProgroundError(
                    "is missing, though the frame has depth",
                    where=path,
                    todo="complete the walk, or remove what it has only in part",
                )
        path = poses[number]
        pose = parse_matrix(read_text(path), where=path)
        if is_tracked(pose):
            pose = opencv_from_opengl(require_rigid(pose, where=path))
            frames.append(_Files(number, colors[number], depth, things.get(number), pose))
    if not frames:
        raise ProgroundError(
            f"none of the {len(depths)} frames has a pose",
            where=source / "pose",
            todo="render the walk again",
        )
    return frames, len(depths) - len(frames)


def _read_instances(path: Path, camera: Camera) -> np.ndarray:
    """The number of the thing at each pixel, uint16 [H, W], 0 = none."""
    read = read_npy_image(path)
    require_size(path, (read.shape[1], read.shape[0]), camera)
    with np.errstate(invalid="ignore"):
        numbers = read.astype(np.uint16)
    if not (numbers == read).all():
        raise ProgroundError(
            f"has values that are no whole numbers from 0 to {LARGEST_NUMBER}",
            where=path,
            todo="render the walk again",
        )
    return numbers


def _read_classes(path: Path) -> tuple[dict[int, str], np.ndarray]:
    """Names of the classes in the order of the alphabet, numbered from 1; and the class of each
    thing, uint16 [65536], by the thing's number."""
    first, *lines = read_text(path).splitlines() or [""]
    if first.strip() != FIRST_LINE:
        raise ProgroundError(
            f"does not begin with {FIRST_LINE!r}", where=path, todo="give the data set's own file"
        )
    name_of: dict[int, str] = {}
    for line_number, line in enumerate(lines, start=2):
        try:
            number, _, name, _ = next(csv.reader([line], strict=True))
            if not 0 < int(number) <= LARGEST_NUMBER:
                raise ValueError(f"the number {number}")
            name_of[int(number)] = name
        except (csv.Error, StopIteration, ValueError) as error:
            raise ProgroundError(
                'is not number, colour, "name", region',
                where=f"{path}:{line_number}",
                todo="mend or remove the line",
            ) from error
    names = sorted(set(name_of.values()))
    label_of = np.zeros(LARGEST_NUMBER + 1, np.uint16)
    for thing, name in name_of.items():
        label_of[thing] = names.index(name) + 1
    return dict(enumerate(names, start=1)), label_of
