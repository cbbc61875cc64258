from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pycolmap
import pytest

from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from recorders.formats.colmap.lens import MOST_ERROR_PX, camera_of, parameter_count

SIZE = WIDTH, HEIGHT = 640, 480
ONE, TWO = [400.0, 322.0, 238.0], [400.0, 401.0, 322.0, 238.0]
EXACT = {
    "SIMPLE_PINHOLE": [*ONE],
    "PINHOLE": [*TWO],
    "SIMPLE_RADIAL": [*ONE, -0.1],
    "RADIAL": [*ONE, -0.1, 0.02],
    "OPENCV": [*TWO, -0.1, 0.02, 0.003, -0.004],
    "FULL_OPENCV": [*TWO, -0.1, 0.02, 0.003, -0.004, 0.01, 0.1, 0.02, 0.03],
    "SIMPLE_FISHEYE": [*ONE],
    "FISHEYE": [*TWO],
    "SIMPLE_RADIAL_FISHEYE": [*ONE, -0.1],
    "RADIAL_FISHEYE": [*ONE, -0.1, 0.02],
    "OPENCV_FISHEYE": [*TWO, -0.1, 0.02, 0.003, -0.004],
}
THIN_PRISM = [-0.02, 0.01, 1e-4, -5e-5, -0.003, 0.001, 5e-5, -3e-5]
ARIA = [0.405, -0.489, 0.1745, 1.13, -1.70, 0.65, 1.4e-4, -5e-4, -3e-4, 8e-5, 5e-4, -6e-5]
FITTED = [
    ("FOV", [257.0, 256.0, 322.0, 238.0, 0.92], "fisheye"),
    ("FOV", [500.0, 500.0, 320.0, 240.0, 0.5], "fisheye"),
    ("FOV", [200.0, 200.0, 320.0, 240.0, 0.95], "fisheye"),  # sees nothing in the corners
    ("SIMPLE_DIVISION", [*ONE, -0.12], "fisheye"),
    ("DIVISION", [*TWO, -0.2], "fisheye"),
    ("DIVISION", [*TWO, 0.1], "rational lens"),  # a fisheye's would turn around
    ("EUCM", [300.0, 301.0, 320.0, 240.0, 0.6, 1.1], "fisheye"),
    ("EUCM", [190.0, 190.0, 320.0, 240.0, 0.57, 1.2], "fisheye"),  # some rays lead backwards
    ("THIN_PRISM_FISHEYE", [*TWO, -0.02, 0.01, 0.0, 0.0, -0.003, 0.001, 0.0, 0.0], "fisheye"),
    ("THIN_PRISM_FISHEYE", [*TWO, *THIN_PRISM], "rational lens"),
    (
        "RAD_TAN_THIN_PRISM_FISHEYE",
        [*TWO, *(-0.02, 0.01, -0.002, 0.001, 0, 0, 1e-4, -5e-5, -3e-5, 8e-6, 5e-5, -6e-6)],
        "rational lens",
    ),
]
REFUSED = [
    ("THIN_PRISM_FISHEYE", [*TWO, 0.2, 0.2, 0.005, -0.004, -0.1, 0.4, -0.003, 0.004]),
    ("RAD_TAN_THIN_PRISM_FISHEYE", [300.0, 300.0, 320.0, 240.0, *ARIA]),
]


def seen_points(theirs: pycolmap.Camera) -> tuple[np.ndarray, np.ndarray]:
    """Points [N, 3] that a camera sees, less than 85 degrees off its axis, and their pixels."""
    pixels = np.random.default_rng(3).uniform((0, 0), SIZE, (800, 2))
    rays = theirs.cam_ray_from_img(pixels)
    seen = (rays[:, 2] > np.cos(np.radians(85))) & (
        abs(theirs.img_from_cam(rays) - pixels) < 1e-3
    ).all(axis=1)
    points = rays[seen] * np.linspace(0.5, 4, seen.sum())[:, None]
    assert len(points) > 400
    return points, theirs.img_from_cam(points)


def test_every_model_is_tried() -> None:
    tried = {*EXACT, *(name for name, *_ in FITTED), "EQUIRECTANGULAR"}
    assert tried == set(pycolmap.CameraModelId.__members__) - {"INVALID"}


@pytest.mark.parametrize("name", EXACT)
def test_exact_lenses(name: str) -> None:
    theirs = pycolmap.Camera(model=name, width=WIDTH, height=HEIGHT, params=EXACT[name])
    points, pixels = seen_points(theirs)
    number = int(pycolmap.CameraModelId.__members__[name].value)
    camera, how = camera_of(name, *SIZE, EXACT[name], where="cameras.txt:1")
    assert (camera, how) == camera_of(number, *SIZE, EXACT[name], where="cameras.bin")
    assert how == ""
    assert (camera.width, camera.height, camera.cx, camera.cy) == (WIDTH, HEIGHT, 322, 238)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-6)
    assert parameter_count(name, where="") == parameter_count(number, where="") == len(EXACT[name])


@pytest.mark.parametrize("name", ["SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV", "FOV", "DIVISION"])
def test_lenses_that_bend_nothing_are_ideal(name: str) -> None:
    count = parameter_count(name, where="")
    known = ONE if name == "SIMPLE_RADIAL" else TWO
    params = [*known, *[0.0] * (count - len(known))]
    camera, how = camera_of(name, *SIZE, params, where="")
    assert (camera, how) == (Camera(*SIZE, known[0], known[-3], 322.0, 238.0), "")


@pytest.mark.parametrize(("name", "params", "stand_in"), FITTED)
def test_other_lenses_are_fitted(name: str, params: list[float], stand_in: str) -> None:
    theirs = pycolmap.Camera(model=name, width=WIDTH, height=HEIGHT, params=params)
    points, pixels = seen_points(theirs)
    camera, how = camera_of(name, *SIZE, params, where="cameras.txt:1")
    text, within = how.removesuffix(" px").split(" within ")
    assert text == f"{name}, as OpenCV's {stand_in}"
    assert float(within) <= MOST_ERROR_PX
    apart_px = np.linalg.norm(camera.project(points) - pixels, axis=1)
    assert apart_px.max() <= float(within)
    assert (camera, how) == camera_of(name, *SIZE, params, where="")


@pytest.mark.parametrize(("name", "params", "stand_in"), FITTED)
def test_a_fit_shows_nothing_that_the_lens_does_not(
    name: str, params: list[float], stand_in: str
) -> None:
    """An image without distortion looks up every pixel where the camera projects its ray."""
    theirs = pycolmap.Camera(model=name, width=WIDTH, height=HEIGHT, params=params)
    camera, how = camera_of(name, *SIZE, params, where="")
    assert stand_in in how
    rays = camera.pinhole().directions.reshape(-1, 3).astype(np.float64)
    ours = camera.project(rays)
    shown = ((ours >= 0) & (ours <= SIZE)).all(axis=1)
    apart_px = np.linalg.norm(ours - theirs.img_from_cam(rays), axis=1)[shown]
    assert shown.mean() > 0.5
    assert apart_px.max() <= MOST_ERROR_PX


@pytest.mark.parametrize(("name", "params"), REFUSED)
def test_hopeless_lenses_are_refused(name: str, params: list[float]) -> None:
    message = rf"^cameras.txt:1: the camera, a {name}, is \S+ px off .*image_undistorter"
    with pytest.raises(ProgroundError, match=message) as caught:
        camera_of(name, *SIZE, params, where="cameras.txt:1")
    assert float(caught.value.what.split(" px off")[0].split()[-1]) > MOST_ERROR_PX


def test_a_lens_that_hardly_looks_forward_is_refused() -> None:
    with pytest.raises(ProgroundError, match=r"^here: the camera, a FOV, looks forward in hardly"):
        camera_of("FOV", *SIZE, [20.0, 20.0, 320.0, 240.0, 0.95], where="here")


def test_panoramas_and_unknown_models_are_refused() -> None:
    with pytest.raises(ProgroundError, match=r"^here: the camera model EQUIRECTANGULAR is of pan"):
        camera_of("EQUIRECTANGULAR", *SIZE, [640.0, 480.0], where="here")
    for model in ("NEWEST", "INVALID", "7", "", -1, 1000, 2**31 - 1):
        with pytest.raises(ProgroundError, match=rf"^here: the camera model {model} is not one"):
            camera_of(model, *SIZE, TWO, where="here")
        with pytest.raises(ProgroundError, match=rf"^here: the camera model {model} is not one"):
            parameter_count(model, where="here")


@pytest.mark.parametrize("name", ["PINHOLE", "OPENCV", "FOV", "EUCM", "RAD_TAN_THIN_PRISM_FISHEYE"])
@pytest.mark.parametrize(
    ("size", "place", "value", "message"),
    [
        (SIZE, 0, float("nan"), "not finite"),
        (SIZE, 3, float("inf"), "not finite"),
        (SIZE, -1, 1e9, "or above 1e\\+08"),
        (SIZE, 1, -1e300, "or above 1e\\+08"),
        (SIZE, 0, 0.0, "a focal length is not above 0"),
        (SIZE, 1, -5.0, "a focal length is not above 0"),
        ((0, 480), 0, 400.0, "a size of 0x480"),
        ((640, -1), 0, 400.0, "a size of 640x-1"),
        ((2**63, 2**63), 0, 400.0, "a size of 9223372036854775808x"),
        (SIZE, None, 0.0, "parameters, {name} has"),
    ],
)
def test_numbers_that_are_no_cameras(
    name: str, size: tuple[int, int], place: int | None, value: float, message: str
) -> None:
    params = [*TWO, *[0.01] * (parameter_count(name, where="") - 4)]
    if place is None:
        params.append(value)
    else:
        params[place] = value
    with pytest.raises(ProgroundError, match=f"^here: .*{message.format(name=name)}"):
        camera_of(name, *size, params, where="here")


def test_any_numbers_end_soon() -> None:
    rng = np.random.default_rng(11)
    names = sorted(set(pycolmap.CameraModelId.__members__) - {"INVALID", "EQUIRECTANGULAR"})
    accepted = 0
    for turn in range(60):
        name = names[turn % len(names)]
        count = parameter_count(name, where="")
        params = (rng.normal(size=count) * 10.0 ** rng.uniform(-3, 8, count)).tolist()
        params[:2] = np.abs(params[:2]).tolist()
        size = rng.integers(1, 5000, 2).tolist()
        start = time.perf_counter()
        try:
            camera, how = camera_of(name, *size, params, where="")
        except ProgroundError:
            continue
        finally:
            assert time.perf_counter() - start < 5
        accepted += 1
        assert np.isfinite(camera.distortion).all()
        assert how == "" or name not in EXACT
    assert accepted > 10


def test_pycolmap_is_imported_only_for_a_camera() -> None:
    code = "import sys, recorders.formats.colmap.source; print('pycolmap' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ
    )
    assert found.stdout == "False\n"
