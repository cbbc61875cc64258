from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from proground_log.camera import Calibration, Camera, pose_from_quaternion, transform
from proground_log.errors import ProgroundError
from recorders.formats.colmap.scale import (
    MOST_VIEWS,
    View,
    fit_scale,
    pixels_inside,
    scale_from_depth,
    scale_from_distances,
)

METRES_PER_UNIT = 0.3
COLOR = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
DEPTH = Camera(80, 60, 70.0, 71.0, 41.0, 29.0)
PLANE_NORMAL, PLANE_M = np.array([0.3, -0.2, 1.0]), 2.0
"""The plane n x = d in the depth camera's axes; its depth varies between 1.4 and 3.2 m."""


def mount(baseline_m: float) -> np.ndarray:
    quaternion = np.array([0.01, -0.02, 0.005, 1.0])
    return pose_from_quaternion(np.array([baseline_m, 0.01, 0.05]), quaternion)


def view(baseline_m: float, seed: int = 0, *, wrong_share: float = 0.0) -> View:
    """Points on a plane in units, and the plane's depth image in millimetres."""
    rng = np.random.default_rng(seed)
    depth_from_color = mount(baseline_m)
    depth_m = PLANE_M / (DEPTH.directions @ PLANE_NORMAL)
    pixels = rng.uniform((5, 5), (75, 55), (400, 2))
    directions = np.c_[(pixels - (DEPTH.cx, DEPTH.cy)) / (DEPTH.fx, DEPTH.fy), np.ones(400)]
    points_m = directions * (PLANE_M / (directions @ PLANE_NORMAL))[:, None]
    points = transform(np.linalg.inv(depth_from_color), points_m) / METRES_PER_UNIT
    wrong = rng.random(400) < wrong_share
    points[wrong] *= rng.uniform(0.3, 1, (int(wrong.sum()), 1))
    calibration = Calibration(COLOR, DEPTH, depth_from_color)
    return View(points, calibration, lambda: np.round(depth_m * 1e3).astype(np.uint16))


def test_the_scale_agrees_with_a_depth_camera_beside_the_colour_camera() -> None:
    scale = scale_from_depth([view(0.15), view(0.15, 1)], where="depth")
    assert scale.metres_per_unit == pytest.approx(METRES_PER_UNIT, rel=5e-4)
    assert scale.residual < 5e-3
    # Taken for one camera, the two would be half a decimetre of depth apart.
    together = [
        View(v.points, Calibration(COLOR, DEPTH, np.eye(4)), v.read_depth)
        for v in (view(0.15), view(0.15, 1))
    ]
    assert (
        abs(scale_from_depth(together, where="depth").metres_per_unit / METRES_PER_UNIT - 1) > 0.01
    )


def test_a_third_of_wrong_points_changes_little() -> None:
    views = [view(0.05, seed, wrong_share=0.3) for seed in range(4)]
    scale = scale_from_depth(views, where="depth")
    assert scale.metres_per_unit == pytest.approx(METRES_PER_UNIT, rel=0.01)
    assert "1600 track points against depth, residual" in scale.note
    assert scale.note.startswith("0.30")


def test_weights_decide_between_ratios_that_differ_by_little() -> None:
    ratios = np.concatenate([np.linspace(0.98, 1.02, 50), np.linspace(1.02, 1.06, 50)])
    near = np.repeat([9.0, 1.0], 50)
    assert fit_scale(ratios, near, "").metres_per_unit == pytest.approx(1.004, abs=0.002)
    assert fit_scale(ratios, near[::-1], "").metres_per_unit == pytest.approx(1.036, abs=0.002)
    assert fit_scale(ratios, np.ones(100), "").metres_per_unit == pytest.approx(1.02, abs=0.001)


def test_not_every_view_is_read() -> None:
    read = []

    def counted(one: View, number: int) -> View:
        def depth() -> np.ndarray:
            read.append(number)
            return one.read_depth()

        return View(one.points, one.calibration, depth)

    one = view(0.0)
    views = [counted(one, number) for number in range(3 * MOST_VIEWS)]
    scale_from_depth(views, where="depth")
    assert len(set(read)) == MOST_VIEWS
    assert {0, 3 * MOST_VIEWS - 1} <= set(read)


def test_too_few_points_are_refused() -> None:
    one = view(0.0)
    empty = View(one.points, one.calibration, lambda: np.zeros((60, 80), np.uint16))
    behind = View(-one.points, one.calibration, one.read_depth)
    for views in ([empty], [behind]):
        with pytest.raises(ProgroundError, match="depth/: only 0 points") as caught:
            scale_from_depth(views, where="depth/")
        assert "--scale" in str(caught.value)


def test_pixels_end_at_the_image() -> None:
    where = np.array([[0.0, 0.0], [63.9, 47.9], [64.0, 0.0], [0.0, -0.1], [np.nan, 1], [1e300, 1]])
    rows, columns, inside = pixels_inside(where, COLOR)
    assert inside.tolist() == [True, True, False, False, False, False]
    assert (rows.tolist(), columns.tolist()) == ([0, 47], [0, 63])


CENTRES = {"a.jpg": np.zeros(3), "b.jpg": np.array([3.0, 0, 4]), "c.jpg": np.array([0, 2.0, 0])}


def test_known_distances(tmp_path: Path) -> None:
    path = tmp_path / "distances.txt"
    path.write_text(
        "# measured by tape\na.jpg b.jpg 1.0\n\na.jpg c.jpg 0.4  # table\nc.jpg a.jpg 4\n"
    )
    scale = scale_from_distances(path, CENTRES)
    assert scale.metres_per_unit == pytest.approx(0.2)  # two agree, and the third is ten times off
    assert "3 known distances" in scale.note


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# none\n", "has no distances"),
        ("\na.jpg b.jpg\n", ":2: is not two images and metres"),
        ("a.jpg b.jpg far", ":1: is not two images and metres"),
        ("a.jpg d.jpg 1", r":1: d\.jpg is no image of the model"),
        ("a.jpg b.jpg 0", ":1: a distance has to be above 0"),
        ("a.jpg b.jpg nan", ":1: a distance has to be above 0"),
        ("a.jpg a.jpg 1", ":1: a distance has to be above 0"),
    ],
)
def test_a_broken_list_of_distances_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "distances.txt"
    path.write_text(text)
    with pytest.raises(ProgroundError, match=message) as caught:
        scale_from_distances(path, CENTRES)
    assert str(path) in str(caught.value)
