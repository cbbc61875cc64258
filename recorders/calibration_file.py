"""A rig's calibration, to override what a format is known to have: a JSON file or a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from proground_log.camera import FISHEYE_TERMS, Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from recorders.reading.json_file import read_json

EXAMPLE = (
    '{"depth": {"width": 640, "height": 480, "fx": 585, "fy": 585, "cx": 320, "cy": 240}, '
    '"color": {..., "distortion": [k1, k2, p1, p2, k3]}, "depth_from_color": [4 rows of 4]}'
)


def read_calibration(path: Path) -> Calibration:
    """Read a calibration; principal points count pixel centres as whole numbers (OpenCV, ROS).

    Of a log (.mcap) it is that of its recording. In a JSON file `color` defaults to the depth
    camera and `depth_from_color` to the identity: a registered rig.

    Raises:
        ProgroundError: the file is missing or describes no rig; says how to write one.
    """
    if path.suffix == ".mcap":
        return LogReader(path).calibration
    content = read_json(path)
    try:
        depth = _camera(content["depth"])
        color = _camera(content["color"]) if "color" in content else depth
        depth_from_color = np.array(content.get("depth_from_color", np.eye(4)), dtype=float)
    except (ValueError, KeyError, TypeError, ArithmeticError) as error:
        raise ProgroundError(
            f"is not a calibration ({error!r})", where=path, todo=f"write it like {EXAMPLE}"
        ) from error
    return Calibration(color, depth, require_rigid(depth_from_color, where=path))


def _camera(content: dict[str, Any]) -> Camera:
    width, height = int(float(content["width"])), int(float(content["height"]))
    fx, fy, cx, cy = (float(content[name]) for name in ("fx", "fy", "cx", "cy"))
    distortion = _distortion(content)
    if not (np.isfinite([cx, cy, *distortion]).all() and 0 < min(fx, fy) <= max(fx, fy) < np.inf):
        raise ValueError("a number is not finite, or a focal length not above 0")
    if min(width, height) < 1:
        raise ValueError(f"a size of {width}x{height}")
    return Camera.from_integer_centres(width, height, fx, fy, cx, cy, distortion)


def _distortion(content: dict[str, Any]) -> tuple[float, ...]:
    """The terms of the lens; four are common without k3, so that a fisheye has to be named."""
    terms, fisheye = (
        tuple(float(value) for value in content.get(name, ())) for name in ("distortion", "fisheye")
    )
    if len(terms) not in (0, 4, 5, 8):
        raise ValueError(
            f"{len(terms)} numbers of distortion, not k1 k2 p1 p2 k3 (k3 may be left out, or "
            "k4 k5 k6 follow)"
        )
    if len(fisheye) not in (0, FISHEYE_TERMS) or (terms and fisheye):
        raise ValueError("a fisheye has k1 k2 k3 k4, and no other distortion")
    return fisheye or ((*terms, 0.0) if len(terms) == 4 else terms)
