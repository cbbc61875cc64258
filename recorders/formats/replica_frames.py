"""Renderings of Replica on disk: numbered images, and a line of the trajectory for each number."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from proground_log.errors import ProgroundError
from recorders.reading.association import read_text
from recorders.reading.images import numbered_files


@dataclass(frozen=True)
class Images:
    """The images of one kind.

    Args:
        folder: where they are.
        stem: what stands before the number in their names.
        digits: how many the number is padded to.
        suffixes: what may stand behind it, the usual one first.
    """

    folder: Path
    stem: str
    digits: int = 1
    suffixes: tuple[str, ...] = ("png",)

    def find(self) -> dict[int, Path]:
        """The images by number; raises a ProgroundError where there is no such folder."""
        return numbered_files(self.folder, rf"{self.stem}(\d+)\.(?:{'|'.join(self.suffixes)})")

    def path(self, number: int) -> Path:
        """Where the image of a number should be."""
        return self.folder / f"{self.stem}{number:0{self.digits}d}.{self.suffixes[0]}"


@dataclass(frozen=True)
class FrameFiles:
    """Where one frame is: its number, its images, and its line in the trajectory (from 1)."""

    number: int
    color: Path
    depth: Path
    labels: Path | None
    instances: Path | None
    pose_text: str
    pose_where: str


def find_frames(source: Path, colors: Images, depths: Images, trajectory: Path) -> list[FrameFiles]:
    """The frames in the order of their numbers, each of them complete.

    Args:
        source: the scene; its semantic_class/ and semantic_instance/ are taken where they are.
        colors, depths: the images that every frame has.
        trajectory: a pose a line, of frame 0 first.

    Raises:
        ProgroundError: a folder or file is missing, or a frame has its files only in part.
    """
    classes = Images(source / "semantic_class", "semantic_class_")
    instances = Images(source / "semantic_instance", "semantic_instance_")
    color_of, depth_of = colors.find(), depths.find()
    class_of, instance_of = (
        images.find() if images.folder.is_dir() else None for images in (classes, instances)
    )
    lines = read_text(trajectory).splitlines()
    if not depth_of:
        raise ProgroundError(
            f"has no {depths.stem}*.png", where=depths.folder, todo="give a rendering of Replica"
        )
    frames = []
    for number, depth in depth_of.items():
        pose_where = f"{trajectory}:{number + 1}"
        for is_missing, where in (
            (number not in color_of, colors.path(number)),
            (class_of is not None and number not in class_of, classes.path(number)),
            (instance_of is not None and number not in instance_of, instances.path(number)),
            (number >= len(lines), pose_where),
        ):
            if is_missing:
                raise ProgroundError(
                    "is missing, though the frame has depth",
                    where=where,
                    todo="complete the scene, or remove what it has only in part",
                )
        frames.append(
            FrameFiles(
                number=number,
                color=color_of[number],
                depth=depth,
                labels=class_of[number] if class_of else None,
                instances=instance_of[number] if instance_of else None,
                pose_text=lines[number],
                pose_where=pose_where,
            )
        )
    return frames
