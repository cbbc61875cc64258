"""The page's floor plan: what is free, what stands there, and which object is where."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon

from proground_log.report.figures import INK, STYLE, svg_uri

WIDTH, TALLEST = 4.6, 6.5
"""Inches."""
STATE_COLORS = {"unknown": "#9aa3ad", "free": "#cfe3f5", "occupied": "#3b424b"}
"""By the number of the state that a cell is in."""
WAY = "#e8590c"


@dataclass(frozen=True)
class Outline:
    """An object seen from above.

    Args:
        name: what is written on it.
        corners_m: float64 [N, 2], on the plan, in order.
        color: "#rrggbb".
    """

    name: str
    corners_m: np.ndarray
    color: str


def floor_chart(
    cells: np.ndarray,
    origin_m: np.ndarray,
    cell_m: float,
    axis_names: tuple[str, str],
    way_m: np.ndarray,
    outlines: Sequence[Outline],
) -> str:
    """The plan as a data URI.

    Args:
        cells: uint8 [X, Y], 0 unknown, 1 free, 2 occupied.
        origin_m: [2], the corner of cell (0, 0).
        cell_m: side of a cell.
        axis_names: what the plan's axes are called.
        way_m: [P, 2], where the camera went.
        outlines: the objects.
    """
    far_m = origin_m + np.array(cells.shape) * cell_m
    extent = (float(origin_m[0]), float(far_m[0]), float(origin_m[1]), float(far_m[1]))
    palette = np.array([list(bytes.fromhex(c[1:])) for c in STATE_COLORS.values()], np.uint8)
    with mpl.rc_context({**STYLE, "axes.grid": False}), warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        height = min(TALLEST, 0.9 + WIDTH * cells.shape[1] / cells.shape[0])
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.add_subplot(aspect="equal")
        axes.imshow(palette[cells.T], origin="lower", extent=extent, interpolation="none")
        axes.plot(*way_m.T, color=WAY, linewidth=0.9)
        for outline in outlines:
            frame = Polygon(outline.corners_m, fill=False, linewidth=1.4, edgecolor=outline.color)
            axes.add_patch(frame)
            # Names come from people: a $ in them begins no formula.
            x_m, y_m = outline.corners_m.mean(axis=0)
            axes.text(
                x_m, y_m, outline.name, ha="center", va="center",
                fontsize=8, color="#14181d", parse_math=False,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.75, "lw": 0},
            )  # fmt: skip
        axes.set_xlim(extent[:2])
        axes.set_ylim(extent[2:])
        axes.set_xlabel(f"{axis_names[0]} (m)")
        axes.set_ylabel(f"{axis_names[1]} (m)")
        shown = [*STATE_COLORS.items(), ("the camera's way", WAY)]
        patches = [Patch(facecolor=color, edgecolor=INK, lw=0.4, label=n) for n, color in shown]
        figure.legend(
            handles=patches, loc="outside lower center", ncols=4, frameon=False, columnspacing=1.2
        )
        return svg_uri(figure)
