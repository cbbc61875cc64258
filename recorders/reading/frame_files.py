"""Frames whose images are files: numbered from folder to folder, found whole, read one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, require_rigid
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.reading.association import (
    frame_stamp_ns,
    is_tracked,
    parse_matrix,
    parse_pose,
    read_text,
)
from recorders.reading.images import numbered_files, read_color, read_depth, read_labels


@dataclass(frozen=True)
class FrameFiles:
    """Where one frame is: its times, its pose and its images.

    Args:
        stamp_ns, color_stamp_ns: times of the depth image and of the colour image.
        color, depth: files of the two images.
        world_from_camera: pose of the depth camera, float64 [4, 4].
        labels, instances: files of the class of each pixel and of its thing, where there are any.
    """

    stamp_ns: int
    color_stamp_ns: int
    color: Path
    depth: Path
    world_from_camera: np.ndarray
    labels: Path | None = None
    instances: Path | None = None

    def read(
        self, index: int, cameras: Calibration, *, depth_per_m: float | None = None
    ) -> SensorFrame:
        """Read the images as frame `index` of a log.

        Args:
            index: number of the frame in its log.
            cameras: those of this frame; images of another size are refused.
            depth_per_m: units of the depth image in a metre, for depth as float32 in metres;
                without it depth stays uint16, in millimetres.

        Raises:
            ProgroundError: an image is missing, broken, or of another size.
        """
        color = read_color(self.color, cameras.color)
        depth = read_depth(self.depth, cameras.depth)
        if depth_per_m is not None:
            depth = np.divide(depth, depth_per_m, dtype=np.float32)
        return SensorFrame(
            index=index,
            stamp_ns=self.stamp_ns,
            color_stamp_ns=self.color_stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=depth,
            world_from_camera=self.world_from_camera,
            labels=read_labels(self.labels, cameras.color) if self.labels else None,
            instances=read_labels(self.instances, cameras.color) if self.instances else None,
        )


@dataclass(frozen=True)
class Numbered:
    """The files of one kind in a folder, one a frame, with the frame's number in their names.

    Args:
        folder: where they are.
        pattern: a regular expression for the whole name, with the number as its first group.
        example: what the file of a frame is called, for messages: `{number}` and, where names
            are longer than their number, `{stem}` of the depth image stand in it.
    """

    folder: Path
    pattern: str
    example: str

    def find(self) -> dict[int, Path]:
        """The files by number; raises a ProgroundError where there is no such folder."""
        return numbered_files(self.folder, self.pattern)

    def of_frame(self, found: dict[int, Path], number: int, depth: Path) -> Path:
        """The file of a frame that has depth; raises a ProgroundError where there is none."""
        if number not in found:
            raise _incomplete(self.folder / self.example.format(number=number, stem=depth.stem))
        return found[number]


def pose_files(poses: Numbered) -> Callable[[int, Path], np.ndarray | None]:
    """Poses that are files of 16 numbers each; a frame whose pose is not finite has none.

    Returns:
        What gives a frame's world_from_camera, float64 [4, 4], or None, by its number and its
        depth image; it raises a ProgroundError where the file is missing, broken or not rigid.
    """
    found = poses.find()

    def read(number: int, depth: Path) -> np.ndarray | None:
        path = poses.of_frame(found, number, depth)
        pose = parse_matrix(read_text(path), where=path)
        return require_rigid(pose, where=path) if is_tracked(pose) else None

    return read


def pose_lines(trajectory: Path) -> Callable[[int, Path], np.ndarray | None]:
    """Poses that are lines of 16 numbers in one file, that of frame 0 first; as `pose_files`."""
    lines = read_text(trajectory).splitlines()

    def read(number: int, _depth: Path) -> np.ndarray | None:
        where = f"{trajectory}:{number + 1}"
        if number >= len(lines):
            raise _incomplete(where)
        return parse_pose(lines[number], where=where)

    return read


def find_frames(
    depths: Numbered,
    colors: Numbered,
    pose_of: Callable[[int, Path], np.ndarray | None],
    *,
    rate_hz: int,
    labels: Numbered | None = None,
    instances: Numbered | None = None,
    todo: str,
) -> tuple[list[FrameFiles], int]:
    """The frames that have a pose, each of them whole, in the order of their numbers.

    Args:
        depths, colors: the images that every frame has.
        pose_of: see `pose_files` and `pose_lines`.
        rate_hz: the frames' times are their numbers at this rate.
        labels, instances: images of truth, which every frame has or none: nothing where there is
            no such folder.
        todo: what to give instead, for the message where there is no depth or no pose.

    Returns:
        The frames, and the number of those left out for want of a pose.

    Raises:
        ProgroundError: there are no frames, a folder or file is missing, or a pose is broken.
    """
    depth_of = depths.find()
    if not depth_of:
        example = depths.example.format(number=0)
        raise ProgroundError(f"has no images such as {example}", where=depths.folder, todo=todo)
    kinds = {"color": colors}
    for name, kind in (("labels", labels), ("instances", instances)):
        if kind is not None and kind.folder.is_dir():
            kinds[name] = kind
    found = {name: kind.find() for name, kind in kinds.items()}
    frames = []
    for number, depth in depth_of.items():
        pose = pose_of(number, depth)
        if pose is None:
            continue
        stamp_ns = frame_stamp_ns(number, rate_hz)
        paths = {name: kind.of_frame(found[name], number, depth) for name, kind in kinds.items()}
        frames.append(FrameFiles(stamp_ns, stamp_ns, depth=depth, world_from_camera=pose, **paths))
    if not frames:
        raise ProgroundError(
            f"none of the {len(depth_of)} frames has a pose", where=depths.folder, todo=todo
        )
    return frames, len(depth_of) - len(frames)


def _incomplete(where: object) -> ProgroundError:
    return ProgroundError(
        "is missing, though the frame has depth",
        where=where,
        todo="complete the recording, or remove what it has only in part",
    )
