"""Command record."""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from pglog.common import (
    SAME,
    AsJson,
    Output,
    shown_progress,
    warn,
)
from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.locations import is_same, located


@dataclass(frozen=True)
class FormatOptions:
    """What some of the formats can be told; `calibration` fits nearly all of them."""

    calibration: Path | None = None
    """JSON file, or a log of the same rig, that overrides the cameras."""
    max_time_difference_s: float | None = None
    """tum, redwood, ROS bags: most between a colour and a depth image."""
    trajectory: Path | None = None
    """redwood, icl-nuim: file of poses."""
    label_set: str | None = None
    """scannet: classes of label-filt: scannet, nyu40 or scannet-to-nyu40, which converts."""
    min_confidence: int | None = None
    """record3d, arkitscenes: depth below it counts as not measured: 0 (keep all), 1 or 2."""
    color: str | None = None
    """arkitscenes: folder of colour images: lowres_wide, vga_wide or wide."""
    depth: str | None = None
    """colmap: folder of depth images of the colour images; arkitscenes: highres_depth."""
    depth_unit_scale_factor: float | None = None
    """nerfstudio: metres of one depth unit."""
    images: Path | None = None
    """colmap: folder of the images."""
    model: int | None = None
    """colmap: which of the models in sparse/."""
    scale: float | None = None
    """colmap: metres of one unit of the model."""
    distances: Path | None = None
    """colmap: text file of known distances, `image image metres` a line, to fit the scale to."""
    color_topic: str | None = None
    """ROS bags: colour images."""
    depth_topic: str | None = None
    """ROS bags: depth images."""
    color_info_topic: str | None = None
    """ROS bags: CameraInfo of the colour images."""
    depth_info_topic: str | None = None
    """ROS bags: CameraInfo of the depth images."""
    odometry_topic: str | None = None
    """ROS bags: Odometry or PoseStamped to take poses from, instead of tf."""
    world_frame: str | None = None
    """ROS bags: the world's coordinate frame."""
    max_pose_gap_s: float | None = None
    """ROS bags: transforms further apart are not interpolated between."""
    seed: int | None = None
    """synthetic: varies the room."""
    frames: int | None = None
    """synthetic: frames on the camera's way."""
    noise: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """synthetic: noise of a real sensor."""

    def given(self, format: str) -> dict[str, object]:
        """The options that were given, as the format's class takes them."""
        from recorders.calibration_file import read_calibration

        given = {
            field.name: value
            for field in dataclasses.fields(self)
            if (value := getattr(self, field.name)) is not None and value is not False
        }
        if self.calibration is not None:
            given["calibration"] = read_calibration(self.calibration)
        if self.depth is not None and format == "colmap":
            given["depth"] = located(self.depth)
        return given


def _name(source: Path) -> str:
    """What the log calls the source: its own name, also for "." and ".."."""
    return source.name if source.name not in ("", "..") else source.resolve().name


def record_command(
    format: Annotated[str, Positional, tyro.conf.arg(metavar="FORMAT")],
    source: Positional[Path | None] = None,
    *,
    output: Output,
    start: int = 0,
    stop: int | None = None,
    stride: int = 1,
    jobs: int | None = None,
    options: Annotated[FormatOptions, tyro.conf.arg(name="")] = FormatOptions(),
    overwrite: bool = False,
    as_json: AsJson = False,
) -> int:
    """Turn a data set into a log.

    Args:
        format: auto (find out), seven-scenes, tum, icl-nuim, replica, replica-semantic,
            scannet-sens, scannet, scannetpp, hm3dsem-walk, record3d, arkitscenes, nerfstudio,
            redwood, colmap, ros2-bag, ros1-bag, or synthetic (the built-in room).
        source: the data set, a path or a URL; synthetic has none.
        output: the log to write (.mcap).
        start: first frame.
        stop: frame to stop before.
        stride: take every so many-th frame.
        jobs: threads to read with; the log is the same for any number.
        options: of the formats.
        overwrite: replace the output.
        as_json: print JSON, for programs.
    """
    from recorders.record import record, require_output
    from recorders.registry import AUTO, detect, open_source

    if source is not None and is_same(source, output):
        what, todo = "the output is the data set to record", "choose another name"
        raise ProgroundError(what, where=output, todo=todo)
    require_output(output, overwrite=overwrite)
    if format == AUTO and source is not None:
        detection = detect(source)
        format = detection.format
        print(f"{source}: {format}, since it {detection.reason}", file=sys.stderr)
    opened = open_source(format, source, **options.given(format))
    name = format if source is None else _name(source)
    selection = Selection(start, stop, stride)
    with shown_progress("record") as progress:
        recording = record(
            opened, name, output, selection, overwrite=overwrite, progress=progress, jobs=jobs
        )
    for warning in recording.warnings:
        warn(warning)
    if as_json:
        print(json.dumps({"log": str(output), **dataclasses.asdict(recording)}, indent=2))
        return SAME
    size_mb = output.stat().st_size / 1e6
    print(f"{output}: {recording.frames} frames, {size_mb:.1f} MB")
    for keyword, note in recording.notes.items():
        print(f"  {keyword}: {note}")
    return SAME
