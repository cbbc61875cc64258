"""Walks through Habitat-Matterport 3D Semantics, as HOV-SG renders them.

A walk's folder has rgb/, depth/ (millimetres, 0 where there is nothing) and pose/ with files
<scene>_%06d.{png,txt}: 16 numbers, world_from_camera with OpenGL's axes; semantic/*.npy has the
number of the thing at each pixel, which the data set's <scene>.semantic.txt names.
"""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.files import nearest_above
from proground_log.frame import SensorFrame
from recorders.reading.association import read_text
from recorders.reading.axes import opencv_from_opengl
from recorders.reading.frame_files import FrameFiles, Numbered, find_frames, pose_files
from recorders.reading.images import read_encoded, require_size
from recorders.reading.layout import holds
from recorders.reading.npy import read_npy_image

FRAME_RATE_HZ = 5
"""A frame is a step of 0.2 m or a turn of 5 degrees: with this rate, at a walking pace."""
LARGEST_NUMBER = 65535
FIRST_LINE = "HM3D Semantic Annotations"
_POSES = "[0-9A-Za-z]" * 11 + "_" + "[0-9]" * 6 + ".txt"
"""The data set's scenes have names of 11 characters."""


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
        instances = _read_instances(files.instances, camera) if files.instances else None
        labels = None
        if instances is not None and self._label_of is not None:
            labels = self._label_of[instances]
        frame = replace(files, instances=None).read(index, self.calibration)
        return replace(frame, labels=labels, instances=instances)

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


def _find_frames(source: Path) -> tuple[list[FrameFiles], int]:
    """The frames that have a pose, in our axes, and the number of the others."""
    name = r".+[_-](\d+)\."
    frames, lost = find_frames(
        Numbered(source / "depth", name + "png", "<scene>_000000.png"),
        Numbered(source / "rgb", name + "(?:png|jpe?g)", "{stem}.png"),
        pose_files(Numbered(source / "pose", name + "txt", "{stem}.txt")),
        rate_hz=FRAME_RATE_HZ,
        instances=Numbered(source / "semantic", name + "npy", "{stem}.npy"),
        todo="give the folder of a walk as HOV-SG's script renders it",
    )
    return [
        replace(files, world_from_camera=opencv_from_opengl(files.world_from_camera))
        for files in frames
    ], lost


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
