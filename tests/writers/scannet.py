"""Writes scannet data as its public description has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from proground_log.frame import SensorFrame
from recorders.room import RoomSource
from tests.writers.scannet_sens import intrinsic_of

COLUMNS = ("id", "raw_category", "category", "count", "nyu40id", "eigen13id", "nyuClass")


STEP = 5
"""Exports often leave frames out."""


def text_of(matrix: np.ndarray) -> str:
    """As NumPy's savetxt with %f, which is what SensReader uses."""
    return "".join(" ".join(f"{x:f}" for x in row) + "\n" for row in matrix)


def labels_ply() -> bytes:
    """Three vertices as in *_vh_clean_2.labels.ply: with alpha, and NYU40's labels."""
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nproperty uchar alpha\nproperty ushort label\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    kinds = [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in "rgba"), ("label", "<u2")]
    vertices = np.zeros(3, np.dtype(kinds))
    vertices["x"], vertices["label"] = (1, 2, 3), (5, 0, 39)
    return header.encode() + vertices.tobytes() + b"\3" + np.arange(3, dtype="<i4").tobytes()


def write_scene(
    scene: Path, room: RoomSource, frames: Sequence[SensorFrame], *, truth: bool = True
) -> Path:
    """Write frames of the room as SensReader and the data set's archives lay them out."""
    folders = ("color", "depth", "pose", "intrinsic")
    for name in (*folders, "label-filt", "instance-filt") if truth else folders:
        (scene / name).mkdir(parents=True)
    for name in ("color", "depth"):
        camera = getattr(room.calibration, name)
        (scene / f"intrinsic/intrinsic_{name}.txt").write_text(text_of(intrinsic_of(camera)))
        (scene / f"intrinsic/extrinsic_{name}.txt").write_text(text_of(np.eye(4)))
    for index, frame in enumerate(frames):
        number = index * STEP
        (scene / f"color/{number}.jpg").write_bytes(frame.color)
        cv2.imwrite(str(scene / f"depth/{number}.png"), frame.depth)
        (scene / f"pose/{number}.txt").write_text(text_of(frame.world_from_camera))
        if truth:
            assert frame.labels is not None
            assert frame.instances is not None
            instances = frame.instances.astype(np.uint8)
            cv2.imwrite(str(scene / f"label-filt/{number}.png"), frame.labels)
            cv2.imwrite(str(scene / f"instance-filt/{number}.png"), instances)
    if truth:
        (scene / "scene0000_00_vh_clean_2.labels.ply").write_bytes(labels_ply())
    (scene / "scene0000_00_vh_clean_2.ply").write_bytes(b"ply\nwithout labels")
    return scene


def true_names(room: RoomSource) -> dict[int, str]:
    """The room's classes, without "nothing"."""
    return {label: name for label, name in room.label_names.items() if label > 0}


def write_label_table(folder: Path, names: dict[int, str]) -> Path:
    """A table where class n is class n % 40 + 1 of NYU40, but for one that has none."""
    rows = [
        [str(label), name, name, "9", str(label % 40 + 1) if label != 2 else "", "1", name]
        for label, name in names.items()
    ]
    path = folder / "scannetv2-labels.combined.tsv"
    path.write_text("".join("\t".join(row) + "\n" for row in [COLUMNS, *rows]))
    return path


def with_things(frames: Sequence[SensorFrame]) -> list[SensorFrame]:
    """The frames, each class in the left half a thing of its own, and each in the right half."""
    found = []
    for frame in frames:
        assert frame.labels is not None
        is_right = np.arange(frame.labels.shape[1]) >= frame.labels.shape[1] // 2
        things = np.where(frame.labels > 0, 2 * frame.labels + is_right, 0)
        found.append(replace(frame, instances=things.astype(np.uint16)))
    return found
