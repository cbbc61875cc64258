"""ScanNet as its SensReader exports it, with class images and a labelled mesh where they are there.

A scene's folder has color/%d.jpg, depth/%d.png (millimetres, 0 where nothing was measured),
pose/%d.txt (world_from_camera, not finite where tracking was lost) and intrinsic/*.txt; then
label-filt/%d.png, instance-filt/%d.png and *_vh_clean_2.ply, *_vh_clean_2.labels.ply.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from proground_log.camera import Calibration, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import nearest_above
from proground_log.frame import SensorFrame
from recorders.formats.scannet_sens import FRAME_RATE_HZ, camera_of, rig
from recorders.reading.association import parse_matrix, read_text
from recorders.reading.frame_files import FrameFiles, Numbered, find_frames, pose_files
from recorders.reading.images import read_encoded
from recorders.reading.layout import holds

LABEL_TABLE = "scannetv2-labels.combined.tsv"
"""Part of the data set: the classes of its annotators and what they are among others'."""
LabelSet = Literal["scannet", "nyu40", "scannet-to-nyu40"]
LARGEST_LABEL = 65535

# The 40 classes of NYUv2, numbered from 1, spelled as ScanNet does; its labelled mesh has these.
NYU40 = (
    "wall",
    "floor",
    "cabinet",
    "bed",
    "chair",
    "sofa",
    "table",
    "door",
    "window",
    "bookshelf",
    "picture",
    "counter",
    "blinds",
    "desk",
    "shelves",
    "curtain",
    "dresser",
    "pillow",
    "mirror",
    "floor mat",
    "clothes",
    "ceiling",
    "books",
    "refridgerator",
    "television",
    "paper",
    "towel",
    "shower curtain",
    "box",
    "whiteboard",
    "person",
    "night stand",
    "toilet",
    "sink",
    "lamp",
    "bathtub",
    "bag",
    "otherstructure",
    "otherfurniture",
    "otherprop",
)


def recognise(source: Path) -> str | None:
    """Why the path looks like an exported scene of ScanNet, or None."""
    if holds(source, "color/*", "depth/*.png", "pose/*.txt", "intrinsic/intrinsic_depth.txt"):
        return "has color, depth, pose and intrinsic/intrinsic_depth.txt"
    return None


class ScannetSource:
    """One scene; frames are in the order of their numbers, those without a pose left out."""

    name = "scannet"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        label_set: LabelSet = "scannet",
    ) -> None:
        """Find the scene's files and read its poses.

        Args:
            source: the scene's folder.
            calibration: the rig; by default that of the folder intrinsic.
            label_set: what label-filt counts: "scannet", the classes of the annotators, as
                published; "nyu40", as the benchmark's script converts them; "scannet-to-nyu40"
                does what that script does.

        Raises:
            ProgroundError: a file is missing or broken, or no frame has a pose.
        """
        if label_set not in get_args(LabelSet):
            raise ProgroundError(
                f"there is no label set {label_set!r}",
                where=source,
                todo=f"choose one of {', '.join(get_args(LabelSet))}",
            )
        self._frames, lost = _find_frames(source)
        self.calibration = calibration or _read_rig(source, self._frames[0])
        self.notes = {"frames without a pose": str(lost)}
        self.warnings: tuple[str, ...] = ()
        self.label_names: dict[int, str] = {}
        self._relabelled: np.ndarray | None = None
        has_labels = self._frames[0].labels is not None
        if has_labels and label_set != "nyu40":
            self.label_names, nyu40_of = _read_label_table(source)
            self._relabelled = nyu40_of if label_set == "scannet-to-nyu40" else None
        labelled_mesh = _only(source, "*_vh_clean_2.labels.ply")
        if has_labels and label_set == "scannet":
            self._mesh = None
            if labelled_mesh:
                self.notes["true mesh"] = (
                    "left out: its classes are not those of the images, for which the label set "
                    "would have to be scannet-to-nyu40"
                )
        else:
            self._mesh = labelled_mesh
            if has_labels or labelled_mesh:
                self.label_names = dict(enumerate(NYU40, start=1))
            else:
                self._mesh = _only(source, "*_vh_clean_2.ply")

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres."""
        frame = self._frames[index].read(index, self.calibration)
        if frame.labels is None or self._relabelled is None:
            return frame
        return replace(frame, labels=self._relabelled[frame.labels])

    def ground_truth_mesh(self) -> bytes | None:
        """The one labelled mesh where its classes are those of the images; without any classes,
        the one mesh."""
        return self._mesh.read_bytes() if self._mesh else None


def _only(source: Path, pattern: str) -> Path | None:
    found = list(source.glob(pattern))
    return found[0] if len(found) == 1 else None


def _find_frames(source: Path) -> tuple[list[FrameFiles], int]:
    """The frames that have a pose, and the number of the others."""
    png, example = r"(\d+)\.png", "{number}.png"
    return find_frames(
        Numbered(source / "depth", png, example),
        Numbered(source / "color", r"(\d+)\.(?:jpe?g|png)", "{number}.jpg"),
        pose_files(Numbered(source / "pose", r"(\d+)\.txt", "{number}.txt")),
        rate_hz=FRAME_RATE_HZ,
        labels=Numbered(source / "label-filt", png, example),
        instances=Numbered(source / "instance-filt", png, example),
        todo="export a scan that was tracked with ScanNet's SensReader, or record its .sens file",
    )


def _read_rig(source: Path, first: FrameFiles) -> Calibration:
    """The cameras of the folder intrinsic, for images of the first frame's sizes."""
    cameras, base_from = {}, {}
    for name, image_path in (("color", first.color), ("depth", first.depth)):
        path = source / "intrinsic" / f"intrinsic_{name}.txt"
        intrinsic, image = parse_matrix(read_text(path), where=path), read_encoded(image_path)
        cameras[name] = camera_of(intrinsic, image.width, image.height, where=path)
        path = source / "intrinsic" / f"extrinsic_{name}.txt"
        extrinsic = parse_matrix(read_text(path), where=path) if path.is_file() else np.eye(4)
        base_from[name] = require_rigid(extrinsic, where=path)
    return rig(cameras, base_from)


def _read_label_table(source: Path) -> tuple[dict[int, str], np.ndarray]:
    """Names of ScanNet's classes, and for each number, uint16 [65536], its class in NYU40."""
    path = nearest_above(source, LABEL_TABLE)
    if path is None:
        raise ProgroundError(
            f"has no {LABEL_TABLE}, nor has a folder above, to name the classes of label-filt",
            where=source,
            todo="put the data set's file there, or take label-filt out of the scene",
        )
    names, nyu40_of = {}, np.zeros(LARGEST_LABEL + 1, np.uint16)
    lines = read_text(path).splitlines()
    try:
        for row in csv.DictReader(lines, delimiter="\t", quoting=csv.QUOTE_NONE, strict=True):
            label, nyu40 = int(row["id"]), int(row["nyu40id"] or 0)
            if not (0 < label <= LARGEST_LABEL and 0 <= nyu40 <= len(NYU40)):
                raise ValueError(f"classes {label} and {nyu40}")
            names[label], nyu40_of[label] = str(row["raw_category"]), nyu40
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        raise ProgroundError(
            f"does not name the classes ({error!r})",
            where=path,
            todo="it needs the columns id, raw_category and nyu40id, separated by tabs",
        ) from error
    return dict(sorted(names.items())), nyu40_of
