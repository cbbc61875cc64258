"""The page's figures: curves that follow the page's colours, and pictures, all as data URIs."""

from __future__ import annotations

import re
import warnings
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import StringIO
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

SIZE = (3.5, 1.9)
"""Of a chart in inches; the page scales it to the width that it has."""
INK, LIGHT, DARK = "#010203", "#47525f", "#aab4c0"
"""What is drawn in INK becomes LIGHT's or DARK's colour, as the page is."""
CURVE = "#2f7fc1"
STAGE_COLORS = {"decode": "#56b4e9", "perceive": "#e69f00", "insert": "#009e73", "step": "#2f7fc1"}
OTHER_STAGE, ALARM = "#cc79a7", "#d55e00"
STRETCHES = 150
"""A curve of more points is drawn as so many means, with the band that holds most of the points."""
BAND = (10, 90)
LOG_RATIO = 20.0
"""Curves whose largest mean is so many times the smallest are drawn on a log scale."""
JPEG_QUALITY = 88
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "pglog",
    "svg.fonttype": "path",
    "font.size": 8,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": INK,
    "grid.alpha": 0.15,
    "grid.linewidth": 0.5,
}


@dataclass(frozen=True)
class Stretches:
    """A long curve in short: means over equal stretches of it.

    Args:
        x: float64 [S], the middle of each stretch.
        mean: float64 [S].
        low, high: float64 [S], 10th and 90th percentile of the stretch's points.
    """

    x: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


def stretches(values: np.ndarray, most: int = STRETCHES) -> Stretches:
    """Cut values [N], N > 0, at 0, 1, 2 ... into `most` stretches, or into N where N is less."""
    parts = np.array_split(np.asarray(values, np.float64), min(most, len(values)))
    starts = np.cumsum([0, *map(len, parts)])
    bands = np.array([np.percentile(part, BAND) for part in parts])
    return Stretches(
        x=(starts[:-1] + starts[1:] - 1) / 2,
        mean=np.array([part.mean() for part in parts]),
        low=bands[:, 0],
        high=bands[:, 1],
    )


def loss_chart(values: np.ndarray) -> str:
    """A loss over its steps, float [N] with N > 0; a log scale where it falls far."""
    curve = stretches(values)
    with mpl.rc_context(STYLE):
        figure, axes = _chart("step")
        axes.fill_between(curve.x, curve.low, curve.high, color=CURVE, alpha=0.25, linewidth=0)
        axes.plot(curve.x, curve.mean, color=CURVE, linewidth=1.2)
        positive = curve.mean[curve.mean > 0]
        if len(positive) and positive.max() > LOG_RATIO * positive.min():
            axes.set_yscale("log")
            axes.yaxis.set_minor_locator(NullLocator())
        else:
            axes.set_ylim(bottom=min(0.0, float(curve.low.min())))
        return svg_uri(figure)


def line_chart(x: np.ndarray, y: np.ndarray, xlabel: str, *, cap: float | None = None) -> str:
    """A figure y [N] over x [N], as steps, from 0.

    Args:
        x, y: the curve.
        xlabel: what x is.
        cap: drawn as a dashed line, where there is one.
    """
    with mpl.rc_context(STYLE):
        figure, axes = _chart(xlabel)
        axes.step(x, y, where="post", color=CURVE, linewidth=1.2)
        _from_zero(axes, float(y.max(initial=0)), cap)
        return svg_uri(figure)


def stage_chart(
    x: np.ndarray, stages: Mapping[str, np.ndarray], xlabel: str, *, cap: float | None = None
) -> str:
    """Shares [N] by stage over x [N], one on top of the other; see `stage_color`."""
    with mpl.rc_context(STYLE):
        figure, axes = _chart(xlabel)
        colors = [stage_color(stage) for stage in stages]
        axes.stackplot(x, *stages.values(), colors=colors, step="post", linewidth=0)
        _from_zero(axes, float(sum(stages.values(), np.zeros(1)).max(initial=0)), cap)
        return svg_uri(figure)


def stage_color(stage: str) -> str:
    """The colour, "#rrggbb", of a stage of a frame's turn."""
    return STAGE_COLORS.get(stage, OTHER_STAGE)


def hex_color(rgb: Iterable[int]) -> str:
    """RGB, 0 to 255, as "#rrggbb"."""
    return f"#{bytes(int(part) for part in rgb).hex()}"


def svg_uri(figure: Figure) -> str:
    """A figure as a data URI; the same figure gives the same text, with no date in it.

    What is drawn in INK follows the page from light to dark.
    """
    stream = StringIO()
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue()
    themed = (
        f"<style>svg{{color:{LIGHT}}}"
        f"@media(prefers-color-scheme:dark){{svg{{color:{DARK}}}}}</style>"
    )
    text = text[text.index("<svg") :].replace(INK, "currentColor")
    text = re.sub(r"(<svg[^>]*>)", lambda found: found[1] + themed, text, count=1)
    return _uri("image/svg+xml", text.encode())


def jpeg_uri(image: np.ndarray) -> str:
    """A colour image, uint8 [h, w, 3] RGB."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    _, data = cv2.imencode(".jpg", image[..., ::-1], quality)
    return _uri("image/jpeg", data.tobytes())


def png_uri(image: np.ndarray) -> str:
    """An image whose colours mean something, uint8 [h, w, 3] RGB, without loss."""
    _, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return _uri("image/png", data.tobytes())


def depth_picture(depth_m: np.ndarray, far_m: float) -> np.ndarray:
    """Depth [h, w] metres as colours, uint8 [h, w, 3]; black where there is none."""
    colors = colormaps["turbo_r"](np.clip(depth_m / far_m, 0, 1), bytes=True)[..., :3]
    return np.where(depth_m[..., None] > 0, colors, 0).astype(np.uint8)


def _uri(media_type: str, content: bytes) -> str:
    return f"data:{media_type};base64,{b64encode(content).decode()}"


def _chart(xlabel: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlabel(xlabel)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.margins(x=0.01)
    return figure, axes


def _from_zero(axes: Axes, highest: float, cap: float | None) -> None:
    """An axis from 0 that holds all; a line at the cap, where it is near enough to be of use."""
    if cap is not None and cap < 3 * max(highest, 1e-9):
        axes.axhline(cap, color=ALARM, linewidth=1, linestyle="--")
        highest = max(highest, cap)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_ylim(0, 1.08 * highest if highest > 0 else 1)
