"""What the viewer shows when a recording or a log is opened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumnKind

from proground_log.events import MapperKnown
from proground_log.telemetry.counts import drawn

APPLICATION_ID = "proground-log"
BACKGROUND = (24, 26, 31)
TIMELINES = ("frame", "step", "sim_time")
SEMANTIC_LOSSES = ("semantic", "scale", "uncertainty")
"""The terms of the loss that only a replay with a task has."""
HEADS = ("label", "scale", "background", "uncertainty")
"""The scores of `SemanticScores`."""
IN_AND_OUT = ("inserted", "evicted")
"""Figures of a memory that are of one order, and of one plot."""
LANES_SHOWN_S = 5
COLOR_AND_DEPTH = {
    f"{which}/{what}": f"{title}: {which}"
    for what, title in (("color", "Colour"), ("depth", "Depth"))
    for which in ("input", "rendered", "error")
}
"""Titles of views by entity, in rows of three."""
LABELS = {
    "input/labels": "Labels: input",
    "rendered/labels": "Labels: rendered",
    "rendered/semantics": "Embeddings",
}
MEANING = {
    "input/color": "Colour: input",
    **LABELS,
    "rendered/scale": "Scale",
    "rendered/uncertainty": "Uncertainty",
}


def replay_blueprint(mapper: MapperKnown) -> rrb.Blueprint:
    """The layout of a replay's recording: the map, the views beside the input, the curves.

    Args:
        mapper: says what there is to show: losses, what is counted, meaning.
    """
    has_meaning = mapper.task is not None
    plots = []
    if mapper.has_steps:
        plots.append(_loss_tabs() if has_meaning else _losses())
    if has_meaning:
        plots.append(_heads())
    plots += [_group(name, figures) for name, figures in mapper.counts.items() if figures]
    views = (_map_tabs(), _view_tabs()) if has_meaning else (_map_view(), _view_grid())
    pictures = rrb.Horizontal(*views, column_shares=[5, 6])
    curves = rrb.Horizontal(*plots, _log())
    replay = rrb.Vertical(pictures, curves, row_shares=[5, 2], name="Replay")
    documents = [rrb.TextDocumentView(origin="summary", name="Summary")]
    if has_meaning:
        documents.append(rrb.TextDocumentView(origin="task", name="Task"))
    return rrb.Blueprint(
        rrb.Tabs(replay, _budget(), *documents, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # Following puts the cursor at the end: the newest frame and the finished map. All views
        # share the timeline, and a lane is one on simulated time alone.
        rrb.TimePanel(state="collapsed", timeline="sim_time", play_state="following"),
    )


@dataclass(frozen=True)
class Eye:
    """From where a scene is looked at; world axes.

    Args:
        position_m, target_m: of the eye, and what it looks at, [3].
        up: the upward direction, of length 1, [3].
        floor_m: height of the floor along it.
    """

    position_m: tuple[float, ...]
    target_m: tuple[float, ...]
    up: tuple[float, ...]
    floor_m: float


@dataclass(frozen=True)
class LogLayout:
    """What a log's recording has to show.

    Args:
        eye: from where its surface is seen.
        with_labels: whether there is ground truth.
        with_regions: whether there is what perception found.
    """

    eye: Eye
    with_labels: bool
    with_regions: bool


def log_blueprint(layout: LogLayout) -> rrb.Blueprint:
    """The layout of a log as recorded: surface and way, the camera moving, its images."""
    eye = layout.eye
    pictures = [
        rrb.Spatial2DView(origin="world/camera/color", name="Colour"),
        rrb.Spatial2DView(origin="depth", name="Depth"),
    ]
    if layout.with_labels:
        pictures.append(rrb.Spatial2DView(origin="labels", name="Labels"))
    if layout.with_regions:
        pictures.append(rrb.Spatial2DView(origin="found", name="Found"))
    scene = rrb.Spatial3DView(
        origin="world",
        name="Scene: the grid is of 1 m",
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(
            visible=True,
            spacing=1.0,
            plane=rr.components.Plane3D(eye.up, eye.floor_m),
        ),
        eye_controls=rrb.EyeControls3D(
            position=eye.position_m, look_target=eye.target_m, eye_up=eye.up
        ),
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Vertical(*pictures), column_shares=[5, 3]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time"),
    )


def _map_view(name: str = "Map", contents: Sequence[str] = ("$origin/**",)) -> rrb.Spatial3DView:
    up_to_cursor = rrb.VisibleTimeRanges(
        [
            rr.VisibleTimeRange(
                timeline,
                start=rrb.TimeRangeBoundary.infinite(),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
            for timeline in TIMELINES
        ]
    )
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        overrides={"world/trajectory": [up_to_cursor]},
    )


def _map_tabs() -> rrb.Tabs:
    """The same surface in its own colour and in those of its meaning."""
    others = ("Semantics", "semantics"), ("Features", "features"), ("Relevance", "relevance")
    return rrb.Tabs(
        *(
            _map_view(title, ["+ $origin/**", "- $origin/map/**", f"+ $origin/map/{what}/**"])
            for title, what in (("Map", "color"), *others)
        ),
        active_tab=0,
    )


def _view_grid(pictures: Mapping[str, str] = COLOR_AND_DEPTH, name: str = "Views") -> rrb.Grid:
    views = [
        rrb.Spatial2DView(origin=f"view/{entity}", name=title) for entity, title in pictures.items()
    ]
    return rrb.Grid(*views, grid_columns=3, name=name)


def _view_tabs() -> rrb.Tabs:
    """Labels join colour and depth; a tab of its own has all of the meaning."""
    return rrb.Tabs(
        _view_grid(COLOR_AND_DEPTH | LABELS),
        _view_grid(MEANING, "Meaning"),
        active_tab=0,
    )


def _losses(contents: Sequence[str] = ("$origin/**",), name: str = "Losses") -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="loss", contents=contents, name=name, plot_legend=rrb.Corner2D.RightTop
    )


def _loss_tabs() -> rrb.Tabs:
    """Terms of one order together: beside a distance between embeddings all others are flat."""
    semantic, *others = (f"$origin/{name}" for name in SEMANTIC_LOSSES)
    larger = [semantic, "$origin/total"]
    return rrb.Tabs(
        _losses(["+ $origin/**", *(f"- {entity}" for entity in (*larger, *others))]),
        _losses([f"+ {entity}" for entity in larger], "semantic, total"),
        _losses([f"+ {entity}" for entity in others], "scale, uncertainty"),
        active_tab=0,
    )


def _heads() -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="heads",
        name="Heads: % right",
        axis_y=rrb.ScalarAxis(range=(0.0, 100.0)),
        plot_legend=rrb.Corner2D.RightBottom,
    )


def _group(group: str, figures: Mapping[str, Any]) -> rrb.Tabs:
    """A tab for each figure of a group; those by name come first: they explain label images."""
    shown = drawn(figures)
    names = sorted(shown, key=lambda name: not isinstance(shown[name], Mapping | Sequence))
    plots = {name: [name] for name in names if name not in IN_AND_OUT}
    if "samples" in shown:
        plots["in and out"] = list(IN_AND_OUT)
    return rrb.Tabs(
        *(
            rrb.TimeSeriesView(
                origin=group,
                contents=[f"/{group}/{name}" for name in entities],
                name=f"{group}: {title.replace('_', ' ')}" if number == 0 else title,
                axis_y=rrb.ScalarAxis(range=(0.0, 1.0)) if title == "share" else None,
                plot_legend=rrb.Corner2D.LeftTop,
            )
            for number, (title, entities) in enumerate(plots.items())
        ),
        active_tab=0,
    )


def _budget() -> rrb.Vertical:
    """The schedule: stages as lanes on top, figures of each frame below."""
    lanes = rrb.TimeSeriesView(
        origin="budget/lane",
        name=f"Stages: the {LANES_SHOWN_S} s of simulated time before the cursor",
        plot_legend=rrb.Corner2D.LeftTop,
        time_ranges=rr.VisibleTimeRange(
            "sim_time",
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-LANES_SHOWN_S),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        ),
    )
    spent = rrb.TimeSeriesView(
        origin="budget/spent_ms", name="Spent on a frame: ms", plot_legend=rrb.Corner2D.LeftTop
    )
    lag = _budget_plot("Lag, idle, overrun: ms", "lag_ms", "idle_ms", "overrun_ms")
    counts = rrb.Horizontal(
        _budget_plot("Queue: frames", "queue"),
        _budget_plot("Steps of a frame", "steps"),
        _budget_plot("Dropped so far: frames", "dropped"),
        _log("Drops", ["WARN", "ERROR"]),
    )
    return rrb.Vertical(
        lanes, rrb.Horizontal(lag, spent), counts, row_shares=[3, 2, 2], name="Budget"
    )


def _budget_plot(name: str, *entities: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="budget",
        contents=[f"/budget/{entity}" for entity in entities],
        name=name,
        plot_legend=rrb.Corner2D.LeftTop,
    )


def _log(name: str = "Log", levels: Sequence[str] = ("INFO", "WARN", "ERROR")) -> rrb.TextLogView:
    return rrb.TextLogView(
        origin="log",
        name=name,
        columns=rrb.TextLogColumns(
            text_log_columns=[TextLogColumnKind.LogLevel, TextLogColumnKind.Body]
        ),
        # The fingerprint of every input and each keyframe's evictions are for a search.
        rows=rrb.TextLogRows(filter_by_log_level=levels),
    )
