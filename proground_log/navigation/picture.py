"""A way on the floor plan, as a picture."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import networkx as nx
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon

from proground_log.files import written_whole
from proground_log.navigation.floor_plan import FREE, OCCUPIED, FloorPlan
from proground_log.navigation.planner import Route
from proground_log.navigation.voronoi import Cell

WIDTH, SIDE, ABOVE_AND_BELOW, DPI = 8.0, 0.75, 1.25, 130
"""Inches: of the picture, beside the plan, above and below it (title, explanations)."""
FULL_M = 1.0
"""The clearance at which the colours of the free floor end."""
CLEARANCE = colormaps["Blues"].resampled(256)
LIGHTEST, DARKEST = 0.06, 0.5
OCCUPIED_COLOR, UNKNOWN_COLOR = (0.20, 0.21, 0.24), (0.78, 0.77, 0.74)
WAY, GRAPH, START, GOAL = "#e8590c", "#5c7ea3", "#2b8a3e", "#c2255c"
SCALE_BARS_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
HALO = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}


@dataclass(frozen=True)
class Sight:
    """A thing to go to, as the plan shows it.

    Args:
        name: what it is called.
        corners_m: float64 [N, 2], its outline on the plan.
    """

    name: str
    corners_m: np.ndarray


def draw_route(
    path: Path,
    plan: FloorPlan,
    graph: nx.MultiGraph[Cell],
    route: Route,
    sight: Sight | None = None,
) -> None:
    """Draw a way on its plan, seen from above; the same way gives the same picture.

    Args:
        path: the picture (PNG), replaced if it is there.
        plan: the floor.
        graph: the Voronoi graph.
        route: the way.
        sight: the thing to go to, or None.
    """
    lower_m, size_m = plan.origin_m, np.array(plan.cells.shape) * plan.cell_m
    height = (WIDTH - SIDE) * size_m[1] / size_m[0] + ABOVE_AND_BELOW
    figure = Figure(figsize=(WIDTH, float(np.clip(height, 3.5, 14.0))), layout="constrained")
    axes = figure.add_subplot(aspect="equal")
    x_m, y_m = lower_m + size_m
    extent = (float(lower_m[0]), float(x_m), float(lower_m[1]), float(y_m))
    axes.imshow(_colors(plan).swapaxes(0, 1), origin="lower", extent=extent, interpolation="none")
    for _, _, edge in graph.edges(data=True):
        axes.plot(*plan.centres(edge["cells"]).T, color=GRAPH, linewidth=0.9, zorder=2)
    if sight is not None:
        _draw_sight(axes, sight)
    _draw_way(axes, route)
    _draw_scale(axes, extent)
    x_name, y_name = plan.ground.axis_names
    axes.set_xlabel(f"{x_name} (m)")
    axes.set_ylabel(f"{y_name} (m)")
    axes.set_title(
        f"{route.length_m:.2f} m, turns: {route.turns}, "
        f"at least {route.clearance_m.min():.2f} m clear (radius {route.radius_m:.2f} m)",
        fontsize=11,
    )
    _explain(figure)
    with written_whole(path) as temporary, warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing")
        figure.savefig(temporary, format="png", dpi=DPI, metadata={"Software": None})


def _colors(plan: FloorPlan) -> np.ndarray:
    """Colours of the cells in [0, 1], [X, Y, 3]: the free ones the darker the more room."""
    share = np.clip(plan.clearance_m / FULL_M, 0, 1)
    colors = np.asarray(CLEARANCE(LIGHTEST + (DARKEST - LIGHTEST) * share))[..., :3]
    colors[plan.cells == OCCUPIED] = OCCUPIED_COLOR
    colors[(plan.cells != OCCUPIED) & (plan.cells != FREE)] = UNKNOWN_COLOR
    return colors


def _draw_sight(axes: Axes, sight: Sight) -> None:
    outline = Polygon(sight.corners_m, fill=False, edgecolor=GOAL, linewidth=2, zorder=3)
    axes.add_patch(outline)
    x_m, y_m = (sight.corners_m.min(axis=0) + sight.corners_m.max(axis=0)) / 2
    # Names come from people: a $ in them begins no formula.
    axes.text(
        x_m, y_m, sight.name, ha="center", va="center", fontsize=11, color=GOAL, weight="bold",
        bbox=HALO, zorder=6, parse_math=False,
    )  # fmt: skip


def _draw_way(axes: Axes, route: Route) -> None:
    way = route.corners_m
    axes.plot(*way.T, color="white", linewidth=5.5, solid_joinstyle="round", zorder=4)
    axes.plot(*way.T, color=WAY, linewidth=3.2, solid_joinstyle="round", zorder=5)
    for end, color, name in ((way[0], START, "start"), (way[-1], GOAL, "goal")):
        axes.add_patch(
            Circle(end, route.radius_m, facecolor=color, alpha=0.9, edgecolor="white", zorder=6)
        )
        axes.annotate(
            name, end, (0, 13), textcoords="offset points", ha="center", color=color, zorder=7,
            fontsize=9, weight="bold", bbox=HALO,
        )  # fmt: skip
    ahead = 1.9 * route.radius_m * np.array([np.cos(route.heading_rad), np.sin(route.heading_rad)])
    axes.annotate(
        "", way[-1] + ahead, way[-1], zorder=8,
        arrowprops={"arrowstyle": "-|>", "color": GOAL, "linewidth": 2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip


def _draw_scale(axes: Axes, extent: tuple[float, float, float, float]) -> None:
    """A bar of a round length in the lower right corner."""
    left, right, bottom, top = extent
    fitting = [bar_m for bar_m in SCALE_BARS_M if bar_m <= (right - left) / 4]
    bar_m = max(fitting, default=SCALE_BARS_M[0])
    x, y = right - 0.03 * (right - left), bottom + 0.035 * (top - bottom)
    axes.plot((x - bar_m, x), (y, y), color="black", linewidth=8, zorder=9, solid_capstyle="butt")
    axes.plot((x - bar_m, x), (y, y), color="white", linewidth=5, zorder=9, solid_capstyle="butt")
    axes.annotate(
        f"{bar_m:g} m", (x - bar_m / 2, y), (0, 8), textcoords="offset points", ha="center",
        fontsize=9, bbox=HALO, zorder=9,
    )  # fmt: skip


def _explain(figure: Figure) -> None:
    light, dark = (CLEARANCE(share) for share in (LIGHTEST, DARKEST))
    patches = [
        Patch(facecolor=light, edgecolor="#999999", label="free"),
        Patch(facecolor=dark, edgecolor="#999999", label=f"free, {FULL_M:g} m clear"),
        Patch(facecolor=OCCUPIED_COLOR, label="occupied"),
        Patch(facecolor=UNKNOWN_COLOR, edgecolor="#999999", label="unknown"),
        Patch(facecolor=GRAPH, label="Voronoi graph"),
        Patch(facecolor=WAY, label="way"),
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=6, frameon=False, fontsize=9)
