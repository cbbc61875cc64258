"""The camera's way through the room: two smooth rounds, one looking across, one looking out."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from proground_log.streams import stream

CENTER_M = (2.95, 2.5)

WAYPOINTS = np.array(
    # turn_deg, radius_x, radius_y, height_m, gaze_deg from outward, pitch_deg
    [
        (225, 1.95, 1.40, 1.45, 172, -17),
        (270, 1.90, 1.25, 1.40, 180, -15),
        (315, 1.85, 1.35, 1.50, 190, -19),
        (360, 1.85, 1.35, 1.55, 192, -15),
        (405, 1.85, 1.35, 1.45, 182, -22),
        (450, 1.85, 1.35, 1.40, 180, -14),
        (495, 1.80, 1.35, 1.50, 172, -20),
        (540, 1.75, 1.30, 1.55, 150, -16),
        (585, 1.45, 1.10, 1.45, 100, -18),
        (630, 1.25, 0.90, 1.35, 62, -14),
        (675, 1.20, 0.80, 1.30, 45, -20),
        (720, 1.30, 0.85, 1.40, 36, -12),
        (765, 1.35, 0.85, 1.45, 34, -18),
        (810, 1.35, 0.90, 1.35, 42, -10),
        (855, 1.45, 0.95, 1.40, 62, -20),
        (900, 1.70, 1.15, 1.50, 110, -15),
    ],
    dtype=np.float64,
)

STEP_M, STEP_DEG = 0.16, 9.0
"""How much movement and how much turning take equally long."""

SHIFT_M = 0.03
FINE = 4000


def camera_poses(seed: int, frames: int) -> np.ndarray:
    """world_from_camera of every frame, float64 [frames, 4, 4], evenly spread over the way.

    The seed shifts the waypoints by some centimetres and chooses where the way begins.
    """
    rng = stream(seed, "room path")
    turn, radius_x, radius_y, height_m, gaze, pitch = WAYPOINTS.T
    angle = np.radians(turn)
    shift_m = rng.uniform(-SHIFT_M, SHIFT_M, (len(WAYPOINTS), 3))
    phase = float(rng.uniform())
    way = np.stack(
        [
            CENTER_M[0] + radius_x * np.cos(angle) + shift_m[:, 0],
            CENTER_M[1] + radius_y * np.sin(angle) + shift_m[:, 1],
            height_m + shift_m[:, 2],
            # The steady turn of two rounds is added back after the spline, which is periodic.
            gaze,
            pitch,
        ],
        axis=1,
    )
    knots = np.arange(len(way) + 1)
    spline = CubicSpline(knots, np.vstack([way, way[:1]]), bc_type="periodic")
    at = _evenly(spline, len(way), frames, phase)
    x, y, z, gaze_deg, pitch_deg = spline(at).T
    yaw_deg = gaze_deg + turn[0] + at * (720.0 / len(way))
    return np.stack(
        [
            _pose(*row)
            for row in zip(x, y, z, np.radians(yaw_deg), np.radians(pitch_deg), strict=True)
        ]
    )


def _evenly(spline: CubicSpline, length: int, frames: int, phase: float) -> np.ndarray:
    """Spline parameters [frames] at equal shares of movement and turning, from a phase on."""
    fine = np.linspace(0.0, length, FINE + 1)
    change = np.diff(spline(fine), axis=0)
    change[:, 3] += 720.0 / FINE
    moved = np.linalg.norm(change[:, :3], axis=1) / STEP_M
    turned = np.linalg.norm(change[:, 3:], axis=1) / STEP_DEG
    share = np.concatenate([[0.0], np.cumsum(np.hypot(moved, turned))])
    wanted = (phase + np.arange(frames) / frames) % 1.0 * share[-1]
    return np.asarray(np.interp(wanted, share, fine))


def _pose(x: float, y: float, z: float, yaw: float, pitch: float) -> np.ndarray:
    """A level camera at a point, looking along yaw (from +x to +y) and pitch (upwards)."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = x, y, z
    return pose
