"""Registration: bring what two cameras saw into the depth camera's pixels.

The log keeps what the sensors gave; the mapper wants one camera. A registered frame lives in the
depth camera, without its distortion, and colour, labels and regions are looked up by projecting
each depth pixel into the colour camera.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import AT_EDGE, Frame, SensorFrame
from proground_log.log import topics

OCCLUSION_TOLERANCE_M = 0.05
"""A surface this much behind the nearest one along a colour ray is hidden from the colour
camera; sensor noise at 4 m stays below."""
JUMP_SHARE, JUMP_M = 0.05, 0.02
"""Neighbours whose depths differ by more than this share of the depth plus this length lie on two
surfaces: noise grows with depth and stays below, and so does a wall that is not seen edge-on."""


class Registration:
    """Registers the frames of a recording.

    Args:
        calibration: its cameras; a frame that has cameras of its own is registered with those.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._rig = _Rig(calibration)
        self._own_rig = self._rig

    def __call__(self, sensor: SensorFrame) -> Frame:
        """Decode and register a frame; raises a ProgroundError that names it."""
        rig = self._rig_of(sensor)
        color = sensor.decode_color()
        depth_m, labels, regions = sensor.depth_m, sensor.labels, sensor.regions
        owner = None if regions is None else regions.owner
        for image, camera, topic in (
            (color, rig.calibration.color, topics.COLOR),
            (depth_m, rig.calibration.depth, topics.DEPTH),
            (labels, rig.calibration.color, topics.LABELS),
            (owner, rig.calibration.color, topics.REGIONS),
        ):
            if image is not None and image.shape[:2] != (camera.height, camera.width):
                raise ProgroundError(
                    f"the image is {image.shape[1]}x{image.shape[0]}, "
                    f"the camera {camera.width}x{camera.height}",
                    where=f"frame {sensor.index}, {topic}",
                    todo="record the log again with the right calibration",
                )
        valid: np.ndarray = np.ones(color.shape[:2], dtype=np.uint8)
        if rig.depth_maps:
            depth_m = cv2.remap(depth_m, *rig.depth_maps, cv2.INTER_NEAREST)
        if rig.color_maps:
            color = cv2.remap(color, *rig.color_maps, cv2.INTER_LINEAR)
            valid = cv2.remap(valid, *rig.color_maps, cv2.INTER_NEAREST)
            labels, owner = (_nearest(numbers, *rig.color_maps) for numbers in (labels, owner))
        if not rig.calibration.is_registered:
            columns, rows = rig.color_pixels(depth_m)
            valid = cv2.remap(valid, columns, rows, cv2.INTER_NEAREST, borderValue=0)
            color = cv2.remap(color, columns, rows, cv2.INTER_LINEAR, borderValue=0)
            labels, owner = (_nearest(numbers, columns, rows) for numbers in (labels, owner))
        return Frame(
            index=sensor.index,
            stamp_ns=sensor.stamp_ns,
            camera=rig.camera,
            world_from_camera=sensor.world_from_camera,
            depth_m=depth_m,
            color=color,
            color_valid=valid.astype(bool),
            labels=labels,
            regions=regions,
            region_of=None if owner is None else _within_surfaces(owner, depth_m),
        )

    def _rig_of(self, sensor: SensorFrame) -> _Rig:
        """The recording's rig, or the frame's own; the last of these is kept for the next frame."""
        if sensor.calibration is None:
            return self._rig
        if sensor.calibration != self._own_rig.calibration:
            self._own_rig = _Rig(sensor.calibration)
        return self._own_rig


class _Rig:
    """What registration computes once for a pair of cameras."""

    def __init__(self, calibration: Calibration) -> None:
        self.calibration = calibration
        self.camera = calibration.depth.pinhole()
        self.depth_maps = _rectification(calibration.depth)
        self.color_maps = _rectification(calibration.color)
        color_from_depth = np.linalg.inv(calibration.depth_from_color)
        self._color_from_depth = np.ascontiguousarray(color_from_depth[:3], dtype=np.float64)

    def color_pixels(self, depth_m: np.ndarray) -> np.ndarray:
        """See `_color_pixels`."""
        color = self.calibration.color
        intrinsics = np.array([color.fx, color.fy, color.cx, color.cy])
        size = color.height, color.width
        rays = self.camera.directions
        return _color_pixels(depth_m, rays, self._color_from_depth, intrinsics, *size)


def _nearest(
    numbers: np.ndarray | None, columns: np.ndarray, rows: np.ndarray
) -> np.ndarray | None:
    """Look numbers up, which cannot be mixed, at these places; 0 outside of the image."""
    if numbers is None:
        return None
    return cv2.remap(numbers, columns, rows, cv2.INTER_NEAREST, borderValue=0)


def _within_surfaces(owner: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
    """The region of each pixel, int32 [H, W], -1 for none, -2 beside a depth jump or a hole.

    A mask bleeds over the edge of its object, and in 3D what bleeds lies far behind it: such a
    pixel may belong to either side.
    """
    around = np.ones((3, 3), np.uint8)
    nearest_m, farthest_m = cv2.erode(depth_m, around), cv2.dilate(depth_m, around)
    tolerance_m = JUMP_SHARE * depth_m + JUMP_M
    is_jump = (farthest_m - depth_m > tolerance_m) | (depth_m - nearest_m > tolerance_m)
    region_of = owner.astype(np.int32) - 1
    region_of[is_jump | (nearest_m <= 0)] = AT_EDGE
    return region_of


def _rectification(camera: Camera) -> tuple[np.ndarray, np.ndarray] | None:
    """The maps for cv2.remap that take the distortion out; None for an ideal lens."""
    if camera.is_ideal:
        return None
    k, d, size = (
        camera.k_integer_centres,
        np.array(camera.distortion),
        (camera.width, camera.height),
    )
    if camera.is_fisheye:
        x, y = cv2.fisheye.initUndistortRectifyMap(k, d, np.eye(3), k, size, cv2.CV_32FC1)
    else:
        x, y = cv2.initUndistortRectifyMap(k, d, None, k, size, cv2.CV_32FC1)
    return x, y


@numba.njit(cache=True)
def _color_pixels(
    depth_m: np.ndarray,
    rays: np.ndarray,
    color_from_depth: np.ndarray,
    intrinsics: np.ndarray,
    height: int,
    width: int,
) -> np.ndarray:
    """Column and row where the colour camera sees each depth pixel, float32 [2, H, W] for cv2.

    -9 where there is no depth, where the colour camera does not look, and where it sees a
    nearer surface instead.
    """
    rows, columns = depth_m.shape
    fx, fy, cx, cy = intrinsics
    pixels = np.full((2, rows, columns), -9.0, dtype=np.float32)
    depth_in_color = np.zeros((rows, columns), dtype=np.float32)
    nearest_m = np.full((height, width), np.inf, dtype=np.float32)
    m = color_from_depth
    for row in range(rows):
        for column in range(columns):
            z = depth_m[row, column]
            if z <= 0:
                continue
            x, y = rays[row, column, 0] * z, rays[row, column, 1] * z
            color_z = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            if color_z <= 0:
                continue
            u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / color_z + cx - 0.5
            v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / color_z + cy - 0.5
            if u < 0 or v < 0 or u > width - 1 or v > height - 1:
                continue
            pixels[0, row, column] = u
            pixels[1, row, column] = v
            depth_in_color[row, column] = color_z
            i, j = int(v + 0.5), int(u + 0.5)
            nearest_m[i, j] = min(nearest_m[i, j], color_z)
    for row in range(rows):
        for column in range(columns):
            if pixels[0, row, column] < 0:
                continue
            i, j = int(pixels[1, row, column] + 0.5), int(pixels[0, row, column] + 0.5)
            if depth_in_color[row, column] > nearest_m[i, j] + OCCLUSION_TOLERANCE_M:
                pixels[:, row, column] = -9.0
    return pixels
