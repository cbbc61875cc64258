from __future__ import annotations

import json
from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from recorders.calibration_file import read_calibration

CAMERA = {"width": 640, "height": 480, "fx": 500, "fy": 501, "cx": 320, "cy": 240}


def written(folder: Path, content: object) -> Path:
    path = folder / "rig.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("lens", "distortion"),
    [
        ({}, ()),
        ({"distortion": [0.1, 0.2, 0.3, 0.4]}, (0.1, 0.2, 0.3, 0.4, 0.0)),
        ({"distortion": [0.1, 0.2, 0.3, 0.4, 0.5]}, (0.1, 0.2, 0.3, 0.4, 0.5)),
        ({"fisheye": [0.1, 0.2, 0.3, 0.4]}, (0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_a_lens_is_a_fisheye_only_where_it_is_called_one(
    tmp_path: Path, lens: dict[str, object], distortion: tuple[float, ...]
) -> None:
    camera = read_calibration(written(tmp_path, {"depth": {**CAMERA, **lens}})).depth
    assert camera.distortion == distortion
    assert camera.is_fisheye == ("fisheye" in lens)


@pytest.mark.parametrize(
    "content",
    [
        [],
        {"depth": []},
        {"depth": {**CAMERA, "width": float("inf")}},
        {"depth": {**CAMERA, "distortion": 0.1}},
        {"depth": {**CAMERA, "fisheye": [0.1]}},
        {"depth": {**CAMERA, "fisheye": [0.1] * 4, "distortion": [0.1] * 5}},
        {"depth": CAMERA, "depth_from_color": [[1, 0], [0]]},
    ],
)
def test_what_is_no_calibration_is_refused(tmp_path: Path, content: object) -> None:
    path = written(tmp_path, content)
    with pytest.raises(ProgroundError, match=rf"{path}: is not a calibration .*write it like"):
        read_calibration(path)


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text("depth: 3")
    with pytest.raises(ProgroundError, match=rf"{path}: is not JSON"):
        read_calibration(path)
