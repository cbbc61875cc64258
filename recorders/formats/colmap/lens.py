"""COLMAP's lenses as OpenCV's: what pycolmap knows of each, and the nearest that a Camera can be.

A camera has its model's parameters: focal lengths, principal point, then the terms of the lens.
Most models are special cases of OpenCV's; of any other, the rays of its pixels are fitted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from proground_log.camera import FISHEYE_TERMS, Camera
from proground_log.errors import ProgroundError

if TYPE_CHECKING:
    import pycolmap

MOST_ERROR_PX = 0.1
"""A fitted lens may be this far from the model's, anywhere in the image."""
NO_ERROR_PX = 0.01
"""A fit this near is not worth another try."""
MOST_PIXELS = 100_000_000
"""An image of more is taken for a broken file."""
LARGEST_PARAMETER = 1e8
"""A camera with a greater one is taken for a broken file."""

# Terms of OpenCV's distortion; those of the models are the first of them, the others are 0.
_EXACT = {
    "SIMPLE_RADIAL": 5,
    "RADIAL": 5,
    "OPENCV": 5,
    "FULL_OPENCV": 8,
    "SIMPLE_FISHEYE": FISHEYE_TERMS,
    "FISHEYE": FISHEYE_TERMS,
    "SIMPLE_RADIAL_FISHEYE": FISHEYE_TERMS,
    "RADIAL_FISHEYE": FISHEYE_TERMS,
    "OPENCV_FISHEYE": FISHEYE_TERMS,
}
# The fisheye comes first: its fit is nearly linear, and quick.
_STAND_INS = {"fisheye": FISHEYE_TERMS, "rational lens": 8}

_FIT_NODES = 17
_CHECK_NODES = 2 * _FIT_NODES - 1
_MOST_EVALUATIONS = 200
_RETURN_PX = 1e-2  # pycolmap's iterations leave up to 2e-4 px where the lens has an inverse
_LEAST_COSINE = 0.05  # 87 degrees off the axis: a Camera's rays look forward
_LEAST_SHARE = 0.1


def parameter_count(model: int | str, *, where: object) -> int:
    """How many parameters a camera model, a number or a name, has.

    Raises:
        ProgroundError: pycolmap does not know the model.
    """
    return len(_lens_of(model, where=where).params)


def camera_of(
    model: int | str, width: int, height: int, params: list[float], *, where: object
) -> tuple[Camera, str]:
    """The camera of a COLMAP model.

    pycolmap is imported here, not before: it takes a fifth of a second.

    Args:
        model: its number, as binary files have it, or its name.
        width, height: size of the image in pixels.
        params: in the model's order, pixel centres at +0.5.
        where: what errors name.

    Returns:
        The camera, and where its lens is fitted, a clause that says how well; else "".

    Raises:
        ProgroundError: a model that pycolmap does not know, numbers that are not a camera's, or
            a lens of which no Camera comes within MOST_ERROR_PX.
    """
    lens = _lens_of(model, where=where)
    if lens.is_spherical():
        raise ProgroundError(
            f"the camera model {lens.model_name} is of panoramas, which no camera can be",
            where=where,
            todo="cut perspective images out of them, as pycolmap.panorama does, and map those",
        )
    focals, extras = list(lens.focal_length_idxs()), list(lens.extra_params_idxs())
    has_all = len(params) == len(lens.params)
    is_sane = bool((np.abs(params) <= LARGEST_PARAMETER).all())  # nan is not
    for fault, what in (
        (not has_all, f"has {len(params)} parameters, {lens.model_name} has {len(lens.params)}"),
        (not is_sane, f"a parameter is not finite, or above {LARGEST_PARAMETER:g}"),
        (has_all and min(params[i] for i in focals) <= 0, "a focal length is not above 0"),
        (
            not (min(width, height) > 0 and width * height <= MOST_PIXELS),
            f"a size of {width}x{height} is not an image's",
        ),
    ):
        if fault:
            raise ProgroundError(what, where=where, todo="export or copy the model again")
    lens.width, lens.height, lens.params = width, height, params
    terms = tuple(params[i] for i in extras)
    if not any(terms) and lens.is_perspective_pinhole():
        return _with_terms(lens, ()), ""
    if lens.model_name in _EXACT:
        rest = _EXACT[lens.model_name] - len(terms)
        return _with_terms(lens, (*terms, *[0.0] * rest)), ""
    return _fitted(lens, where=where)


def _lens_of(model: int | str, *, where: object) -> pycolmap.Camera:
    """A camera of the model, its parameters not yet set."""
    import pycolmap

    for name, known in pycolmap.CameraModelId.__members__.items():
        if model in (name, known.value) and known != pycolmap.CameraModelId.INVALID:
            return pycolmap.Camera.create_from_model_id(0, known, 1.0, 1, 1)
    raise ProgroundError(
        f"the camera model {model} is not one that pycolmap {pycolmap.__version__} knows",
        where=where,
        todo="update pycolmap, or run `colmap image_undistorter` and record what it writes",
    )


def _with_terms(lens: pycolmap.Camera, distortion: tuple[float, ...]) -> Camera:
    """The camera of the lens's focal lengths and principal point, and this distortion."""
    focal, principal = (lens.focal_length_x, lens.focal_length_y), lens.principal_point_idxs()
    cx, cy = (float(lens.params[i]) for i in principal)
    return Camera(lens.width, lens.height, *focal, cx, cy, distortion)


def _fitted(lens: pycolmap.Camera, *, where: object) -> tuple[Camera, str]:
    """The nearest Camera to a lens, and how near it is."""
    least_px, best, stand_in = math.inf, None, ""
    pixels, rays = _seen(lens, _FIT_NODES)
    if len(rays) < _LEAST_SHARE * _FIT_NODES**2:
        raise _refused(lens, "looks forward in hardly any of its pixels", where=where)
    for name, count in _STAND_INS.items():
        camera = _fit(_with_terms(lens, (0.0,) * count), pixels, rays)
        error_px = _error_px(camera, lens)
        if error_px < least_px:
            least_px, best, stand_in = error_px, camera, name
        if least_px < NO_ERROR_PX:
            break
    if best is None or least_px > MOST_ERROR_PX:
        what = f"is {least_px:.2g} px off the nearest lens of OpenCV"
        raise _refused(lens, what, where=where)
    within_px = math.ceil(least_px * 100) / 100
    return best, f"{lens.model_name}, as OpenCV's {stand_in} within {within_px:.2f} px"


def _refused(lens: pycolmap.Camera, what: str, *, where: object) -> ProgroundError:
    return ProgroundError(
        f"the camera, a {lens.model_name}, {what}",
        where=where,
        todo="run `colmap image_undistorter` and record what it writes",
    )


def _grid(width: int, height: int, nodes: int) -> np.ndarray:
    """Pixels [nodes ** 2, 2] all over an image, its border included."""
    across = np.meshgrid(np.linspace(0, width, nodes), np.linspace(0, height, nodes))
    return np.stack(across, axis=-1).reshape(-1, 2)


def _seen(lens: pycolmap.Camera, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [N, 2] of a grid that look forward, and where to: unit rays [N, 3]."""
    pixels = _grid(lens.width, lens.height, nodes)
    rays = lens.cam_ray_from_img(pixels)
    # Past a lens's widest angle some models have rays that lead to other pixels.
    apart_px = np.linalg.norm(lens.img_from_cam(rays) - pixels, axis=1)
    forward = (rays[:, 2] >= _LEAST_COSINE) & (apart_px <= _RETURN_PX)
    return pixels[forward], rays[forward]


def _fit(start: Camera, pixels: np.ndarray, rays: np.ndarray) -> Camera:
    """The camera that by least squares projects the rays [N, 3] to the pixels [N, 2]."""
    from scipy.optimize import least_squares

    def camera(values: np.ndarray) -> Camera:
        fx, fy, cx, cy, *distortion = values.tolist()
        return Camera(start.width, start.height, fx, fy, cx, cy, tuple(distortion))

    def residuals(values: np.ndarray) -> np.ndarray:
        return (camera(values).project(rays) - pixels).ravel()

    values = [start.fx, start.fy, start.cx, start.cy, *start.distortion]
    # Not by method="lm", which gives other last digits each time.
    found = least_squares(residuals, values, x_scale="jac", max_nfev=_MOST_EVALUATIONS)
    return camera(found.x)


def _error_px(camera: Camera, lens: pycolmap.Camera) -> float:
    """How far apart the two project what the lens sees, and what the camera believes it sees.

    The latter is what an image without distortion is made of: beyond the lens's own rays, a
    polynomial may turn around and show them again.
    """
    pixels, rays = _seen(lens, _CHECK_NODES)
    apart_px = np.linalg.norm(camera.project(rays) - pixels, axis=1)
    size = (camera.width, camera.height)
    xy = (_grid(*size, _CHECK_NODES) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    beside = np.concatenate([xy, np.ones_like(xy[:, :1])], axis=1)
    believed = camera.project(beside)
    inside = ((believed >= 0) & (believed <= size)).all(axis=1)
    false_px = np.linalg.norm(lens.img_from_cam(beside) - believed, axis=1)[inside]
    error_px = float(np.concatenate([apart_px, false_px]).max())
    return error_px if math.isfinite(error_px) else math.inf
