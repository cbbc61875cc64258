"""The rerun recording of a replay: the sink that draws what the events say."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr

from proground_log.camera import Camera
from proground_log.events import (
    Event,
    FrameArrived,
    FrameDone,
    KeyframeInserted,
    MapperKnown,
    MeshExtracted,
    RunFinished,
    StateDigested,
    StepDone,
    ViewRendered,
)
from proground_log.files import disk_errors, written_whole
from proground_log.log.upright import nearest_axis, up_direction
from proground_log.palette import CURVE_COLORS, TOTAL_COLOR
from proground_log.telemetry import images
from proground_log.telemetry.blueprint import APPLICATION_ID, SEMANTIC_LOSSES, replay_blueprint
from proground_log.telemetry.budget import BudgetDrawing
from proground_log.telemetry.columns import Moment, ScalarColumns
from proground_log.telemetry.counts import CountsDrawing
from proground_log.telemetry.documents import summary_document
from proground_log.telemetry.semantics import SemanticDrawing
from proground_log.telemetry.surface import coloured
from proground_log.telemetry.upright import VIEW_COORDINATES

CAMERA_IMAGE_WIDTH = 320
"""Width in pixels of the picture in the camera's frustum."""
FRUSTUM_DEPTH_M = 0.3
TRAJECTORY_COLOR = (90, 200, 250)
HELD_OUT_COLOR = (255, 170, 60)
DIGEST_DIGITS = 16


class TelemetrySink:
    """Writes a segment of a rerun recording, its blueprint inside.

    The trajectory is one strip of two points for each frame, on one entity, and the blueprint
    shows all of them up to the cursor: the cost of a frame does not grow with the length of the
    recording, and the path ends where the cursor stands.

    Args:
        path: the .rrd file to write.
        recording_id: the same for all segments of a replay that was interrupted and resumed.
        depth_far_m: depth at the end of the colour map, for all depth views of the recording.
        steps_done: optimisation steps that earlier segments hold.
        last_position_m: where the camera was at the end of the earlier segments, [3].
        dropped_before: dropped frames that earlier segments tell of.
    """

    def __init__(
        self,
        path: Path,
        *,
        recording_id: str,
        depth_far_m: float = 5.0,
        steps_done: int = 0,
        last_position_m: np.ndarray | None = None,
        dropped_before: int = 0,
    ) -> None:
        self._path = path
        self._depth_far_m = depth_far_m
        self._last_position_m = last_position_m
        self._now = Moment(frame=0, step=max(0, steps_done - 1), sim_time_ns=0)
        self._is_upright = False
        self._recording = open_recording(recording_id)
        # Rerun's own file sink waits forever once a disk is full: the bytes are written here.
        self._bytes = rr.binary_stream(self._recording)
        with disk_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb")
        self._scalars = ScalarColumns(self._recording)
        self._styled: set[str] = set()
        self._budget = BudgetDrawing(self._recording, self._scalars, dropped_before)
        self._counts: CountsDrawing | None = None
        self._semantics: SemanticDrawing | None = None

    def on_event(self, event: Event) -> None:
        """Draw one event; the first one tells what there will be to show."""
        self._draw(event)
        self._budget.on_event(event, self._now)
        if self._semantics is not None:
            self._semantics.on_event(event, self._now)
        if isinstance(event, FrameDone):
            self._write(flush=False)

    def _draw(self, event: Event) -> None:
        """Draw what is there with and without meaning."""
        match event:
            case MapperKnown():
                self._on_mapper_known(event)
            case FrameArrived():
                self._on_frame_arrived(event)
            case KeyframeInserted():
                self._on_keyframe(event)
            case StepDone():
                self._on_step(event)
            case FrameDone():
                self._on_frame_done(event)
            case StateDigested():
                self._on_state_digested(event)
            case ViewRendered():
                self._on_view(event)
            case MeshExtracted():
                self._on_mesh(event)
            case RunFinished():
                self._log_static("summary", summary_document(event.summary))

    def flush(self) -> None:
        """Put all that was said so far on the disk: to be called before a checkpoint is taken."""
        self._scalars.send()
        self._write(flush=True)

    def close(self) -> None:
        """Put all on the disk; the file is a segment, for `merge_segments` to make whole."""
        try:
            self.flush()
        finally:
            self._recording.disconnect()
            with disk_errors(self._path):
                self._file.close()

    def _write(self, *, flush: bool) -> None:
        with disk_errors(self._path):
            self._file.write(self._bytes.read(flush=flush) or b"")
            if flush:
                self._file.flush()

    def _on_mapper_known(self, event: MapperKnown) -> None:
        self._recording.send_blueprint(replay_blueprint(event))
        self._counts = CountsDrawing(self._recording, self._scalars, event.counts, event.task)
        if event.task is not None:
            self._semantics = SemanticDrawing(
                self._recording, self._scalars, event.task, has_steps=event.has_steps
            )

    def _on_frame_arrived(self, event: FrameArrived) -> None:
        frame = event.frame
        self._now = Moment(frame.index, self._now.step, event.sim_time_ns)
        if not self._is_upright:
            self._is_upright = True
            up = nearest_axis(up_direction(frame.world_from_camera[None]))
            self._log_static("world", VIEW_COORDINATES[up])
        # Said with every frame: phones refocus, and a resumed replay says what it would have said.
        self._log("world/camera", pinhole(frame.camera))
        pose = frame.world_from_camera
        self._log("world/camera", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        self._log("world/camera", images.jpeg(images.fit_width(frame.color, CAMERA_IMAGE_WIDTH)))
        self._log_trajectory(pose[:3, 3], held_out=event.held_out)
        self._say(f"input {event.input_digest[:DIGEST_DIGITS]}", level="TRACE")
        if event.held_out:
            self._say(f"frame {frame.index} is held out for evaluation")

    def _log_trajectory(self, position_m: np.ndarray, *, held_out: bool) -> None:
        start_m = position_m if self._last_position_m is None else self._last_position_m
        self._last_position_m = position_m
        strip = rr.LineStrips3D(
            [np.stack([start_m, position_m])],
            colors=HELD_OUT_COLOR if held_out else TRAJECTORY_COLOR,
            radii=rr.Radius.ui_points(1.5),
        )
        self._log("world/trajectory", strip)

    def _on_keyframe(self, event: KeyframeInserted) -> None:
        self._scalars.add("buffer/inserted", self._now, event.inserted)
        self._scalars.add("buffer/evicted", self._now, event.evicted)
        if event.evicted:
            self._say(
                f"keyframe {event.frame_index}: {event.inserted:,} samples in, "
                f"{event.evicted:,} evicted",
                level="DEBUG",
            )

    def _on_step(self, event: StepDone) -> None:
        self._now = Moment(event.frame_index, event.step, event.sim_time_ns)
        for name, value in event.losses.items():
            self._style_loss(name)
            self._scalars.add(f"loss/{name}", self._now, value)

    def _style_loss(self, name: str) -> None:
        """Give a term its colour when it first comes; the viewer's own are hard to tell apart."""
        if name in self._styled or name in SEMANTIC_LOSSES:
            return
        terms = len(self._styled - {"total"})
        color, width = CURVE_COLORS[terms % len(CURVE_COLORS)], 1.2
        if name == "total":
            color, width = TOTAL_COLOR, 2.5
        self._styled.add(name)
        self._log_static(f"loss/{name}", rr.SeriesLines(colors=color, widths=width, names=name))

    def _on_frame_done(self, event: FrameDone) -> None:
        self._now = Moment(event.frame_index, self._now.step, event.sim_time_ns)
        if self._counts is not None:
            self._counts.add(event.counts, self._now)

    def _on_state_digested(self, event: StateDigested) -> None:
        lines = (f"{name}={event.digests[name]}\n" for name in sorted(event.digests))
        digest = hashlib.sha256("".join(lines).encode()).hexdigest()
        self._say(f"state after {event.step} steps: {digest[:DIGEST_DIGITS]}")

    def _on_view(self, event: ViewRendered) -> None:
        far_m = self._depth_far_m
        self._log("view/input/color", images.jpeg(event.color))
        self._log("view/input/depth", images.depth(event.depth_m, far_m))
        self._log("view/rendered/color", images.jpeg(event.rendered_color))
        self._log("view/rendered/depth", images.depth(event.rendered_depth_m, far_m))
        color_error = images.color_error(event.color, event.rendered_color)
        self._log("view/error/color", images.jpeg(color_error))
        depth_error = images.depth_error(event.depth_m, event.rendered_depth_m)
        self._log("view/error/depth", depth_error)

    def _on_mesh(self, event: MeshExtracted) -> None:
        self._log("world/map/color", coloured(event, event.colors))

    def _say(self, text: str, *, level: str = "INFO") -> None:
        self._log("log", rr.TextLog(text, level=level))

    def _log(self, entity: str, what: rr.AsComponents) -> None:
        self._now.log(self._recording, entity, what)

    def _log_static(self, entity: str, what: rr.AsComponents) -> None:
        self._recording.log(entity, what, static=True)


def open_recording(recording_id: str) -> rr.RecordingStream:
    """A recording without the wall clock."""
    # Properties would hold the time at which the recording began.
    recording = rr.RecordingStream(APPLICATION_ID, recording_id=recording_id, send_properties=False)
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    return recording


@contextmanager
def recording_written(path: Path, recording_id: str) -> Iterator[rr.RecordingStream]:
    """Give a recording to fill, and write it once it is full; an error leaves the file as it was.

    Args:
        path: the .rrd file, replaced if it is there.
        recording_id: tells it from others in one viewer.
    """
    recording = open_recording(recording_id)
    # Into memory, and then to the disk, for the same reason as in `TelemetrySink`.
    stream = rr.binary_stream(recording)
    yield recording
    content = stream.read(flush=True)
    recording.disconnect()
    with written_whole(path) as temporary:
        temporary.write_bytes(content or b"")


def pinhole(camera: Camera) -> rr.Pinhole:
    """The camera's frustum, for the picture that `CAMERA_IMAGE_WIDTH` shrinks."""
    shown = camera.scaled_to_width(min(camera.width, CAMERA_IMAGE_WIDTH))
    return rr.Pinhole(
        focal_length=(shown.fx, shown.fy),
        principal_point=(shown.cx, shown.cy),
        resolution=(shown.width, shown.height),
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=FRUSTUM_DEPTH_M,
        color=TRAJECTORY_COLOR,
    )
