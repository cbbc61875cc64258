"""A rig's calibration, to override what a format is known to have: a JSON file or a log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.log.reader import LogReader

EXAMPLE = (
    '{"depth": {"width": 640, "height": 480, "fx": 585, "fy": 585, "cx": 320, "cy": 240}, '
    '"color": {..., "distortion": [k1, k2, p1, p2, k3]}, "depth_from_color": [4 rows of 4]}'
)


def read_calibration(path: Path) -> Calibration:
    """Read a calibration; principal points count pixel centres as whole numbers (OpenCV, ROS).

    Of a log (.mcap) it is that of its recording. In a JSON file `color` defaults to the depth
    camera and `depth_from_color` to the identity: a registered rig.
    """
    if path.suffix == ".mcap":
        return LogReader(path).calibration
    try:
        content = json.loads(require_file(path).read_text())
        depth = _camera(content["depth"])
        color = _camera(content["color"]) if "color" in content else depth
        depth_from_color = np.array(content.get("depth_from_color", np.eye(4)), dtype=float)
    except (ValueError, KeyError, TypeError) as error:
        raise ProgroundError(
            f"is not a calibration ({error!r})", where=path, todo=f"write it like {EXAMPLE}"
        ) from error
    return Calibration(color, depth, require_rigid(depth_from_color, where=path))


def _camera(content: dict[str, Any]) -> Camera:
    distortion = tuple(float(value) for value in content.get("distortion", ()))
    width, height = int(content["width"]), int(content["height"])
    fx, fy, cx, cy = (float(content[name]) for name in ("fx", "fy", "cx", "cy"))
    if len(distortion) not in (0, 4, 5, 8):
        raise ValueError(
            f"{len(distortion)} numbers of distortion, not k1 k2 p1 p2 k3 (and k4 k5 k6), "
            "nor k1 k2 k3 k4 of a fisheye"
        )
    if not (np.isfinite([cx, cy, *distortion]).all() and 0 < min(fx, fy) <= max(fx, fy) < np.inf):
        raise ValueError("a number is not finite, or a focal length not above 0")
    if min(width, height) < 1:
        raise ValueError(f"a size of {width}x{height}")
    return Camera.from_integer_centres(width, height, fx, fy, cx, cy, distortion)
