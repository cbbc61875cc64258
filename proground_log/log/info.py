"""A summary of a log, for people and for programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proground_log.camera import Camera
from proground_log.log import topics
from proground_log.log.reader import LogReader
from proground_log.log.task_record import TaskRecord


@dataclass(frozen=True)
class LogInfo:
    """What is in a log; everything is plain JSON.

    Args:
        path: of the file.
        size_bytes: of the file.
        source, format, frames, notes, warnings: as recorded.
        duration_s: from the first frame to the last.
        color_camera, depth_camera: size, intrinsics (pixel centres at +0.5) and distortion.
        registered: whether both are the same camera.
        baseline_m: distance between them.
        bounds_lower_m, bounds_upper_m: the box to map.
        messages: count by topic.
        labels: class names by label.
        has_mesh: whether a labelled ground-truth mesh is attached.
        task: what perception looked for and how many regions it found; None before it ran.
    """

    path: str
    size_bytes: int
    source: str
    format: str
    frames: int
    notes: dict[str, str]
    warnings: tuple[str, ...]
    duration_s: float
    color_camera: dict[str, object]
    depth_camera: dict[str, object]
    registered: bool
    baseline_m: float
    bounds_lower_m: tuple[float, float, float]
    bounds_upper_m: tuple[float, float, float]
    messages: dict[str, int]
    labels: dict[int, str]
    has_mesh: bool
    task: TaskRecord | None


def log_info(path: Path) -> LogInfo:
    """Summarise a log; raises a ProgroundError where it is none."""
    reader = LogReader(path)
    recording, calibration, statistics = reader.recording, reader.calibration, reader.statistics
    counts, duration_s = {}, 0.0
    if statistics is not None:
        by_id = statistics.channel_message_counts
        numbers = sorted((channel.topic, channel.id) for channel in reader.channels.values())
        counts = {topic: by_id.get(number, 0) for topic, number in numbers}
        duration_s = (statistics.message_end_time - statistics.message_start_time) / 1e9
    return LogInfo(
        path=str(path),
        size_bytes=path.stat().st_size,
        source=recording.source,
        format=recording.format,
        frames=recording.frames,
        notes=recording.notes,
        warnings=recording.warnings,
        duration_s=duration_s,
        color_camera=_camera(calibration.color),
        depth_camera=_camera(calibration.depth),
        registered=calibration.is_registered,
        baseline_m=float(np.linalg.norm(calibration.depth_from_color[:3, 3])),
        bounds_lower_m=recording.bounds.lower_m,
        bounds_upper_m=recording.bounds.upper_m,
        messages=counts,
        labels=reader.label_names,
        has_mesh=reader.attachment(topics.MESH_ATTACHMENT) is not None,
        task=reader.task,
    )


def _camera(camera: Camera) -> dict[str, object]:
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": list(camera.distortion),
    }
