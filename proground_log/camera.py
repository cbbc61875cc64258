"""Cameras and poses.

Conventions of the house: metres; camera axes x right, y down, z forward; the centre of the pixel
in column 0 and row 0 lies at (0.5, 0.5). Most data sets and ROS put that centre at (0, 0):
`Camera.from_integer_centres` and `Camera.k_integer_centres` translate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.errors import ProgroundError

FISHEYE_TERMS = 4
_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
RIGID_TOLERANCE = 1e-3
"""How far R^T R may be from the identity: poses in text files carry some six digits."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, with lens distortion as OpenCV has it.

    Args:
        width, height: size of the image in pixels.
        fx, fy, cx, cy: focal lengths and principal point in pixels, pixel centres at +0.5.
        distortion: nothing for an ideal lens; k1 k2 p1 p2 k3, or these and k4 k5 k6 (rational);
            k1 k2 k3 k4 for a fisheye (equidistant). The names in brackets are ROS's.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    @classmethod
    def from_integer_centres(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        distortion: tuple[float, ...] = (),
    ) -> Camera:
        """A camera whose principal point counts pixel centres as whole numbers."""
        return cls(width, height, fx, fy, cx + 0.5, cy + 0.5, distortion)

    @property
    def k_integer_centres(self) -> np.ndarray:
        """The 3x3 matrix that OpenCV and ROS use, float64, pixel centres at whole numbers."""
        return np.array(
            [[self.fx, 0.0, self.cx - 0.5], [0.0, self.fy, self.cy - 0.5], [0.0, 0.0, 1.0]]
        )

    @property
    def is_ideal(self) -> bool:
        """Whether straight lines stay straight; a fisheye bends them even with terms of 0."""
        return not any(self.distortion) and not self.is_fisheye

    @property
    def is_fisheye(self) -> bool:
        """Whether the distortion is that of OpenCV's fisheye model."""
        return len(self.distortion) == FISHEYE_TERMS

    def pinhole(self) -> Camera:
        """The same camera without its distortion."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def scaled_to_width(self, width: int) -> Camera:
        """The camera of the same view at another resolution, its aspect kept to a pixel."""
        return self.resized(width, max(1, round(self.height * width / self.width)))

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same view, its image stretched to another size."""
        x, y = width / self.width, height / self.height
        return Camera(
            width, height, self.fx * x, self.fy * y, self.cx * x, self.cy * y, self.distortion
        )

    @cached_property
    def directions(self) -> np.ndarray:
        """Ray direction through each pixel's centre, z = 1, camera axes, float32 [H, W, 3]."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
        if not self.is_ideal:
            k, d = self.k_integer_centres, np.array(self.distortion)
            undistort = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
            xy = undistort(pixels, k, d, criteria=_UNTIL)
        else:
            xy = (pixels + 0.5 - (self.cx, self.cy)) / (self.fx, self.fy)
        xy = xy.reshape(self.height, self.width, 2)
        return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1).astype(np.float32)

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """Pixel coordinates [N, 2] of points [N, 3] in front of the camera (camera axes)."""
        xy = points_m[:, :2] / points_m[:, 2:]
        if not self.is_ideal:
            points = np.concatenate([xy, np.ones_like(xy[:, :1])], axis=1).astype(np.float64)
            k, d = self.k_integer_centres, np.array(self.distortion)
            still = np.zeros((3, 1))
            if self.is_fisheye:
                pixels, _ = cv2.fisheye.projectPoints(points[:, None], still, still, k, d)
            else:
                pixels, _ = cv2.projectPoints(points, still, still, k, d)
            return pixels.reshape(-1, 2) + 0.5
        return xy * (self.fx, self.fy) + (self.cx, self.cy)

    def unproject(self, depth_m: np.ndarray) -> np.ndarray:
        """Points [H, W, 3] in camera axes of a depth image [H, W] in metres along z."""
        return self.directions * depth_m[..., None]


@dataclass(frozen=True, eq=False)
class Calibration:
    """The two cameras of an RGB-D rig and where they sit.

    Args:
        color, depth: the cameras; the same camera twice where the source is registered.
        depth_from_color: 4x4, takes points from the colour camera's axes to the depth camera's.
    """

    color: Camera
    depth: Camera
    depth_from_color: np.ndarray

    @classmethod
    def registered(cls, camera: Camera) -> Calibration:
        """The calibration of a source whose colour and depth share one camera."""
        return cls(camera, camera, np.eye(4))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Calibration)
            and (self.color, self.depth) == (other.color, other.depth)
            and np.array_equal(self.depth_from_color, other.depth_from_color)
        )

    @property
    def is_registered(self) -> bool:
        """Whether each depth pixel's colour is the pixel at the same place."""
        return self.color == self.depth and np.array_equal(self.depth_from_color, np.eye(4))


def transform(target_from_source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply a 4x4 rigid transform to points [..., 3]."""
    return points @ target_from_source[:3, :3].T + target_from_source[:3, 3]


def pose_from_quaternion(translation_m: np.ndarray, quaternion_xyzw: np.ndarray) -> np.ndarray:
    """The 4x4 matrix, float64, of a translation and a quaternion in x y z w order."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    pose[:3, 3] = translation_m
    return pose


def quaternion_from_pose(pose: np.ndarray) -> np.ndarray:
    """The unit quaternion x y z w, w >= 0, of the rotation in a 4x4 matrix."""
    return Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)


def require_rigid(pose: np.ndarray, *, where: object) -> np.ndarray:
    """Return the pose [4, 4] as float64; raise a ProgroundError unless it is a rigid transform."""
    pose = np.asarray(pose, dtype=np.float64)
    todo = "leave the frame out, or mend its pose in the source"
    if pose.shape != (4, 4):
        raise ProgroundError(f"the pose has shape {pose.shape}, not (4, 4)", where=where, todo=todo)
    if not np.isfinite(pose).all():
        raise ProgroundError("the pose has numbers that are not finite", where=where, todo=todo)
    rotation = pose[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    fault = ""
    if error > RIGID_TOLERANCE:
        fault = f"its rotation is off by {error:.2g}"
    elif np.linalg.det(rotation) < 0:
        fault = "it mirrors"
    elif np.abs(pose[3] - (0, 0, 0, 1)).max() > RIGID_TOLERANCE:
        fault = "its last row is not 0 0 0 1"
    if fault:
        raise ProgroundError(f"the pose is not rigid ({fault})", where=where, todo=todo)
    return pose
