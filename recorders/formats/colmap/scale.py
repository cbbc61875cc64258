"""The metres in a unit of a reconstruction from images alone, out of depth or known distances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera, transform
from proground_log.errors import ProgroundError
from recorders.reading.association import read_text

FEWEST_POINTS = 20
MOST_VIEWS = 100
"""As many views, spread over the recording, tell the scale; to read all would take long."""
HUBER_SIGMAS = 1.345
MAD_TO_SIGMA = 1.4826
ROUNDS = 20


@dataclass(frozen=True)
class Scale:
    """A scale and how well it fits.

    Args:
        metres_per_unit: above 0.
        residual: median relative deviation of what it was fitted to.
        note: both, and what they come from, for people.
    """

    metres_per_unit: float
    residual: float
    note: str


@dataclass(frozen=True, eq=False)
class View:
    """Points of the reconstruction in one image with sensor depth.

    Args:
        points: float64 [N, 3], the colour camera's axes, the reconstruction's unit.
        calibration: the view's cameras.
        read_depth: reads the depth image, uint16 [H, W] in millimetres, 0 = nothing.
    """

    points: np.ndarray
    calibration: Calibration
    read_depth: Callable[[], np.ndarray]


def fit_scale(ratios: np.ndarray, weights: np.ndarray, source: str) -> Scale:
    """The scale that most ratios of metres to units agree on.

    Weighted median of the ratios' logarithms, refined with Huber's weights (Huber, Robust
    Estimation of a Location Parameter, 1964).

    Args:
        ratios: float64 [N], N >= 1, above 0.
        weights: float64 [N], above 0.
        source: what the ratios come from, for the note.
    """
    logs = np.log(ratios)
    order = np.argsort(logs, kind="stable")
    cumulative = np.cumsum(weights[order])
    scale = logs[order][np.searchsorted(cumulative, cumulative[-1] / 2)]
    for _ in range(ROUNDS):
        deviation = np.abs(logs - scale)
        limit = HUBER_SIGMAS * MAD_TO_SIGMA * np.median(deviation)
        trust = weights * np.minimum(1.0, limit / np.maximum(deviation, 1e-12))
        if not trust.any():  # More than half agree exactly.
            break
        scale = np.sum(trust * logs) / np.sum(trust)
    residual = float(np.median(np.abs(np.expm1(logs - scale))))
    factor = float(np.exp(scale))
    note = f"{factor:.5g} m a unit, from {source}, residual {100 * residual:.2g} %"
    return Scale(factor, residual, note)


def scale_from_distances(path: Path, centres: dict[str, np.ndarray]) -> Scale:
    """The scale by known distances between the places that images were taken from.

    Args:
        path: a text file with `image image metres` a line, `#` before comments.
        centres: by image, where its camera was, float64 [3] in the reconstruction's unit.

    Raises:
        ProgroundError: a line is broken, names no image, or there are no lines.
    """
    ratios = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        fields = line.split("#")[0].split()
        if fields:
            ratios.append(_ratio(fields, centres, where=f"{path}:{number}"))
    if not ratios:
        raise ProgroundError(
            "has no distances", where=path, todo="write `image image metres`, one a line"
        )
    return fit_scale(np.array(ratios), np.ones(len(ratios)), f"{len(ratios)} known distances")


def _ratio(fields: list[str], centres: dict[str, np.ndarray], *, where: str) -> float:
    """Metres a unit by one line's distance."""
    todo = "write `image image metres` with two images of the model, or remove the line"
    try:
        first, second, text = fields
        metres = float(text)
    except ValueError as error:
        raise ProgroundError("is not two images and metres", where=where, todo=todo) from error
    for name in (first, second):
        if name not in centres:
            raise ProgroundError(f"{name} is no image of the model", where=where, todo=todo)
    units = float(np.linalg.norm(centres[first] - centres[second]))
    if not (0 < metres < np.inf and units > 0):
        raise ProgroundError("a distance has to be above 0", where=where, todo=todo)
    return metres / units


def pixels_inside(
    coordinates: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns of those pixel coordinates [N, 2] in the image, and which, bool [N]."""
    inside = np.all((coordinates >= 0) & (coordinates < (camera.width, camera.height)), axis=1)
    columns, rows = coordinates[inside].astype(np.int64).T
    return rows, columns, inside


def scale_from_depth(views: Sequence[View], *, where: object) -> Scale:
    """The scale by the depth that a sensor measured where the reconstruction has points.

    The relative error of structured light and stereo grows in proportion to depth, so that a
    point counts by 1 / z^2. It matters: against one model, the ratios of a Kinect rose by 4 %
    from 1 m to 3 m, and counted alike they made the scale 1.8 % too large, so weighted 0.6 %.
    Where the depth camera sits beside the colour camera, the pixel that sees a point depends on
    the scale, and the fit is repeated from the scale before.

    Args:
        views: the images; at most `MOST_VIEWS` of them, spread evenly, are read.
        where: the depth images, for messages.

    Raises:
        ProgroundError: fewer than `FEWEST_POINTS` points fall on depth, or an image is broken.
    """
    steps = np.linspace(0, len(views) - 1, min(len(views), MOST_VIEWS))
    chosen = [views[int(step)] for step in steps]
    scale: Scale | None = None
    for _ in range(ROUNDS):
        before = scale.metres_per_unit if scale else None
        ratios, depth_m = np.concatenate([_ratios(view, before) for view in chosen], axis=1)
        if len(ratios) < FEWEST_POINTS:
            raise ProgroundError(
                f"only {len(ratios)} points of the model fall on measured depth",
                where=where,
                todo="check that the depth belongs to these images, or pass --scale",
            )
        source = f"{len(ratios)} track points against depth"
        scale = fit_scale(ratios, depth_m**-2.0, source)
        if before and abs(scale.metres_per_unit / before - 1) < 1e-4:
            break
    assert scale is not None
    return scale


def _ratios(view: View, metres_per_unit: float | None) -> np.ndarray:
    """Metres a unit by each point that has depth, and that depth in metres, float64 [2, N].

    Without a scale to begin with, the cameras are taken to be in the same place.
    """
    depth_from_color, camera = view.calibration.depth_from_color.copy(), view.calibration.depth
    depth_from_color[:3, 3] /= metres_per_unit or np.inf
    points = transform(depth_from_color, view.points)
    points = points[points[:, 2] > 0]
    if not len(points):
        return np.empty((2, 0))
    rows, columns, inside = pixels_inside(camera.project(points), camera)
    depth_m = view.read_depth()[rows, columns] * 1e-3
    measured = depth_m > 0
    offset_m = view.calibration.depth_from_color[2, 3] if metres_per_unit else 0.0
    units = points[inside][measured, 2] - depth_from_color[2, 3]
    ratios, depth_m = (depth_m[measured] - offset_m) / units, depth_m[measured]
    return np.stack([ratios, depth_m])[:, (ratios > 0) & np.isfinite(ratios)]
