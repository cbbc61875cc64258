"""A log as a rerun recording: all that was seen, the camera's way through it, and each frame."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from proground_log.camera import Calibration, Camera, transform
from proground_log.frame import SensorFrame, evenly
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.log.upright import levelled, nearest_axis, surface_normals, up_direction
from proground_log.palette import label_colors
from proground_log.perception.of_log import perception_of
from proground_log.perception.preview import draw_preview
from proground_log.perception.task import Task
from proground_log.telemetry.blueprint import Eye, LogLayout, log_blueprint
from proground_log.telemetry.rerun_sink import TRAJECTORY_COLOR, open_recording
from proground_log.telemetry.upright import VIEW_COORDINATES

SURFACE_FRAMES = 60
"""At most so many frames, spread over the log, are drawn as the surface."""
SURFACE_POINTS = 600_000
"""At most; the viewer draws them at ease without a graphics card."""
NORMALS_REACH = 8
"""Pixels to the neighbours that tell which way the surface faces: about, for noise is rough."""
CEILING = -0.7
"""Cosine between up and what faces down: ceilings would hide the room from above."""
LABELS_WIDTH = 640
"""Labels are kept raw, and wide images of them would fill the viewer's memory."""
NAMED_SHARE = 0.004
"""A class is named in the image where it covers at least this share of it."""
FLOOR_PERCENTILE = 1.0
"""Of the heights of the surface: where the grid lies; noise reaches below the floor."""
EYE_DISTANCE = 1.0
"""Of the eye from the middle, as a multiple of the box's diagonal."""
EYE_BACK, EYE_UP = 0.66, 0.75
"""Looking down by 49 degrees shows a room behind its walls."""
FRUSTUM_M = 0.25
NAME_COLOR = (255, 255, 255)
POINT_RADIUS = rr.Radius.ui_points(1.2)


def write_log_recording(log: Path, path: Path) -> None:
    """Write a log as a recording with its layout inside.

    Args:
        log: the log (.mcap).
        path: the .rrd file to write.

    Raises:
        ProgroundError: the log is none, or is damaged.
    """
    reader = LogReader(log)
    perception = perception_of(reader)
    recording = open_recording(log.stem)
    drawing = _Drawing(reader, recording, None if perception is None else perception.task)
    recording.save(path)
    for frame in reader.frames():
        drawing.add(frame)
    layout = drawing.finish()
    recording.send_blueprint(log_blueprint(layout))
    recording.flush()
    recording.disconnect()


class _Drawing:
    """Draws frame after frame, and at last what all of them make together."""

    def __init__(self, reader: LogReader, recording: rr.RecordingStream, task: Task | None) -> None:
        self._recording, self._task = recording, task
        self._calibration, self._names = reader.calibration, reader.label_names
        self._register = Registration(reader.calibration)
        self._surface_frames = set(evenly(len(reader), SURFACE_FRAMES))
        self._points_each = SURFACE_POINTS // max(len(self._surface_frames), 1)
        self._points: list[np.ndarray] = []
        self._colors: list[np.ndarray] = []
        self._normals: list[np.ndarray] = []
        self._poses: list[np.ndarray] = []
        self._camera: Camera | None = None
        self._start_ns: int | None = None
        self._with_labels = self._with_regions = False

    def add(self, frame: SensorFrame) -> None:
        """Draw a frame: camera, images, labels, and some of what it saw."""
        start_ns = self._start_ns = frame.stamp_ns if self._start_ns is None else self._start_ns
        self._recording.set_time("frame", sequence=frame.index)
        self._recording.set_time("time", duration=np.timedelta64(frame.stamp_ns - start_ns, "ns"))
        pose, calibration = frame.world_from_camera, frame.calibration or self._calibration
        self._poses.append(pose)
        self._log("world/camera", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        self._draw_images(frame, calibration)
        if frame.labels is not None:
            self._draw_labels(frame.labels)
        if frame.regions is not None and self._task is not None:
            picture = draw_preview(frame.decode_color(), frame.regions, self._task)
            self._log("found", rr.EncodedImage(contents=picture, media_type="image/jpeg"))
            self._with_regions = True
        if frame.index in self._surface_frames:
            self._gather(frame)

    def finish(self) -> LogLayout:
        """Draw the camera's way and the surface; returns how to show it all."""
        points, colors = np.concatenate(self._points), np.concatenate(self._colors)
        normals, poses = np.concatenate(self._normals), np.array(self._poses)
        up = levelled(up_direction(poses), normals[normals.any(axis=1)])
        self._log_static("world", VIEW_COORDINATES[nearest_axis(up)])
        is_shown = normals @ up > CEILING
        surface = rr.Points3D(points[is_shown], colors=colors[is_shown], radii=POINT_RADIUS)
        self._log_static("world/surface", surface)
        mount = self._calibration.depth_from_color
        mounted = rr.Transform3D(translation=mount[:3, 3], mat3x3=mount[:3, :3])
        self._log_static("world/camera/color", mounted)
        line = rr.LineStrips3D(
            [poses[:, :3, 3]], colors=TRAJECTORY_COLOR, radii=rr.Radius.ui_points(1.5)
        )
        self._log_static("world/trajectory", line)
        eye = _eye(points, poses, up)
        return LogLayout(eye, self._with_labels, self._with_regions)

    def _draw_images(self, frame: SensorFrame, calibration: Calibration) -> None:
        """Both as they were recorded."""
        metre = 1000.0 if frame.depth.dtype == np.uint16 else 1.0
        self._log("depth", rr.DepthImage(frame.depth, meter=metre))
        color = rr.EncodedImage(contents=frame.color, media_type=f"image/{frame.color_format}")
        self._draw_pinhole(calibration.color)
        self._log("world/camera/color", color)

    def _draw_pinhole(self, camera: Camera) -> None:
        """Tell of the colour camera where it is not that of the frame before: phones refocus."""
        if camera == self._camera:
            return
        self._camera = camera
        shape = rr.Pinhole(
            focal_length=(camera.fx, camera.fy),
            principal_point=(camera.cx, camera.cy),
            resolution=(camera.width, camera.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=FRUSTUM_M,
            color=TRAJECTORY_COLOR,
        )
        self._log("world/camera/color", shape)

    def _draw_labels(self, labels: np.ndarray) -> None:
        """The classes in their colours, and the names of those that cover much."""
        if not self._with_labels:
            self._with_labels = True
            count = max([int(labels.max()), *self._names]) + 1
            classes = zip(range(count), label_colors(count).tolist(), strict=True)
            context = [
                rr.AnnotationInfo(label, self._names.get(label, ""), color)
                for label, color in classes
            ]
            self._log_static("labels", rr.AnnotationContext(context))
        step = -(-labels.shape[1] // LABELS_WIDTH)
        labels = np.ascontiguousarray(labels[::step, ::step])
        self._log("labels", rr.SegmentationImage(labels))
        shown = [label for label in np.unique(labels).tolist() if label in self._names]
        middles = ((self._names[label], _middle(labels == label)) for label in shown)
        named = [(name, place) for name, place in middles if place is not None]
        names = rr.Points2D(
            [place for _, place in named],
            labels=[name for name, _ in named],
            colors=NAME_COLOR,
            radii=rr.Radius.ui_points(2.0),
            show_labels=True,
        )
        self._log("labels/names", names)

    def _gather(self, sensor: SensorFrame) -> None:
        """Keep some of the surface that a frame saw, in its colours."""
        frame = self._register(sensor)
        known = (frame.depth_m > 0) & frame.color_valid
        step = max(1, math.ceil(math.sqrt(known.sum() / self._points_each)))
        seen = frame.camera.unproject(frame.depth_m)[::step, ::step]
        normals = surface_normals(seen, max(1, NORMALS_REACH // step))
        kept = known[::step, ::step]
        pose = frame.world_from_camera.astype(np.float32)
        self._points.append(transform(pose, seen[kept]))
        self._normals.append(normals[kept] @ pose[:3, :3].T)
        self._colors.append(frame.color[::step, ::step][kept])

    def _log(self, entity: str, what: rr.AsComponents) -> None:
        self._recording.log(entity, what)

    def _log_static(self, entity: str, what: rr.AsComponents) -> None:
        self._recording.log(entity, what, static=True)


def _middle(mask: np.ndarray) -> tuple[float, float] | None:
    """Column and row of the pixel farthest from the edge of a class; None where it is small."""
    if mask.mean() < NAMED_SHARE:
        return None
    # A class that reaches the image's edge ends there.
    padded = np.pad(mask.astype(np.uint8), 1)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(distance.argmax()), mask.shape)
    return float(column) + 0.5, float(row) + 0.5


def _eye(points_m: np.ndarray, poses: np.ndarray, up: np.ndarray) -> Eye:
    """Where all of it is seen from above, and from where the cameras stood: what they saw faces us.

    Args:
        points_m: of the surface, [N, 3].
        poses: world_from_camera, [P, 4, 4].
        up: the upward direction, [3].
    """
    cameras_m = poses[:, :3, 3]
    if not len(points_m):
        points_m = cameras_m
    # A few stray points are no reason to stand far away; the cameras' way has none.
    lower_m, upper_m = np.percentile(points_m, (2, 98), axis=0)
    lower_m = np.minimum(lower_m, cameras_m.min(axis=0))
    upper_m = np.maximum(upper_m, cameras_m.max(axis=0))
    centre_m = (lower_m + upper_m) / 2
    back = cameras_m.mean(axis=0) - points_m.mean(axis=0)
    back -= (back @ up) * up
    length = float(np.linalg.norm(back))
    back = back / length if length > 1e-6 else np.cross(up, np.eye(3)[np.abs(up).argmin()])
    away_m = EYE_DISTANCE * float(np.linalg.norm(upper_m - lower_m))
    eye_m = centre_m + away_m * (EYE_BACK * back + EYE_UP * up)
    floor_m = float(np.percentile(points_m @ up, FLOOR_PERCENTILE))
    return Eye(tuple(eye_m.tolist()), tuple(centre_m.tolist()), tuple(up.tolist()), floor_m)
