"""A data set of small random frames, for tests that need a log but not a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.bounds import Bounds
from proground_log.camera import Calibration, Camera
from proground_log.frame import SensorFrame
from proground_log.log.recording import Origin, Recording
from proground_log.log.writer import LogWriter, open_writer

CAMERA = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)
BOUNDS = Bounds((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0))
LABEL_NAMES = {1: "chair", 2: "Küche", 40: "lamp"}
MESH = b"ply\nnot looked into\x00\xff"
PERIOD_NS = 33_333_333


def color_image(rng: np.random.Generator, camera: Camera) -> np.ndarray:
    """Smooth random colours, so that JPEG keeps them."""
    coarse = rng.integers(0, 256, (4, 5, 3), dtype=np.uint8)
    return cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)


@dataclass
class SmallSource:
    """A Source of `count` frames; the same each time that frame `i` is read."""

    count: int = 5
    calibration: Calibration = field(default_factory=lambda: Calibration.registered(CAMERA))
    in_metres: bool = False
    with_labels: bool = False
    color_format: str = "png"
    name: str = "small"
    notes: dict[str, str] = field(default_factory=lambda: {"kept": "all"})
    warnings: tuple[str, ...] = ()

    @property
    def label_names(self) -> dict[int, str]:
        return dict(LABEL_NAMES) if self.with_labels else {}

    def __len__(self) -> int:
        return self.count

    def frame(self, index: int) -> SensorFrame:
        rng = np.random.default_rng(index)
        cameras = self.calibration
        size = (cameras.depth.height, cameras.depth.width)
        depth: np.ndarray = rng.integers(500, 2500, size).astype(np.uint16)
        depth[rng.random(size) < 0.1] = 0
        if self.in_metres:
            depth = depth.astype(np.float32) / np.float32(1000.7)
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(random_state=index).as_matrix()
        pose[:3, 3] = rng.normal(0, 0.1, 3)
        suffix = ".png" if self.color_format == "png" else ".jpg"
        _, color = cv2.imencode(suffix, color_image(rng, cameras.color))
        labels = rng.choice([0, *LABEL_NAMES], (cameras.color.height, cameras.color.width))
        return SensorFrame(
            index=index,
            stamp_ns=1_700_000_000_000_000_007 + index * PERIOD_NS,
            color_stamp_ns=1_699_999_999_990_000_003 + index * PERIOD_NS,
            color=color.tobytes(),
            color_format=self.color_format,
            depth=depth,
            world_from_camera=pose,
            labels=labels.astype(np.uint16) if self.with_labels else None,
        )

    def ground_truth_mesh(self) -> bytes | None:
        return MESH if self.with_labels else None


def write_log(
    path: Path,
    source: SmallSource | None = None,
    *,
    frames: Iterable[SensorFrame] | None = None,
    announced: int | None = None,
    before_finish: Callable[[LogWriter], None] = lambda _: None,
) -> Path:
    """Write a log of the source, or of these frames instead of its own."""
    source = source or SmallSource()
    origin, mesh = Origin("small data", source.name, source.notes), source.ground_truth_mesh()
    with open_writer(path, source.calibration, origin, source.label_names, mesh) as writer:
        for frame in frames or map(source.frame, range(len(source))):
            writer.write(frame)
        before_finish(writer)
        count = writer.frames if announced is None else announced
        recording = Recording("small data", source.name, count, BOUNDS, source.notes)
        writer.finish(recording)
    return path


def with_frame(source: SmallSource, index: int, **changes: object) -> list[SensorFrame]:
    """The source's frames with one changed."""
    frames = [source.frame(i) for i in range(len(source))]
    frames[index] = replace(frames[index], **changes)
    return frames
