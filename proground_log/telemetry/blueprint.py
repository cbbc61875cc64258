"""What the viewer shows when a recording or a log is opened."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumnKind

from proground_log.log.topics import COLOR, DEPTH, LABELS_PREVIEW

APPLICATION_ID = "proground-log"
BACKGROUND = (24, 26, 31)
TIMELINES = ("frame", "step", "sim_time")


def replay_blueprint() -> rrb.Blueprint:
    """The layout of a replay's recording: the map, the views beside the input, the curves."""
    replay = rrb.Vertical(
        rrb.Horizontal(_map_view(), _view_grid(), column_shares=[5, 6]),
        rrb.Horizontal(_losses(), _buffer(), _log(), column_shares=[4, 3, 4]),
        row_shares=[5, 2],
        name="Replay",
    )
    summary = rrb.TextDocumentView(origin="summary", name="Summary")
    return rrb.Blueprint(
        rrb.Tabs(replay, summary, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # Following puts the cursor at the end: the newest frame and the finished map.
        rrb.TimePanel(state="collapsed", timeline="frame", play_state="following"),
    )


def log_blueprint(
    *, with_labels: bool = False, up: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> rrb.Blueprint:
    """The layout of a log as recorded: depth in space, the camera moving, both images.

    Args:
        with_labels: whether the log has ground truth labels to show.
        up: the world's upward direction.
    """
    pictures = [
        rrb.Spatial2DView(origin=COLOR, name="Colour"),
        rrb.Spatial2DView(origin=DEPTH, name="Depth"),
    ]
    if with_labels:
        pictures.append(rrb.Spatial2DView(origin=LABELS_PREVIEW, name="Labels"))
    scene = rrb.Spatial3DView(
        # Labels would be unprojected as if they were depth.
        contents=["+ /**", "- /ground_truth/**", "- /perception/**"],
        name="Scene",
        background=rrb.Background(color=BACKGROUND),
        eye_controls=rrb.EyeControls3D(eye_up=up),
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Vertical(*pictures), column_shares=[5, 3]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # The transforms carry no stamp of their own, so the camera moves on this timeline only.
        rrb.TimePanel(state="collapsed", timeline="message_log_time"),
    )


def _map_view() -> rrb.Spatial3DView:
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
        name="Map",
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        overrides={"world/trajectory": [up_to_cursor]},
    )


def _view_grid() -> rrb.Grid:
    rows = ("color", "Colour"), ("depth", "Depth")
    columns = ("input", "input"), ("rendered", "rendered"), ("error", "error")
    views = [
        rrb.Spatial2DView(origin=f"view/{which}/{what}", name=f"{title}: {label}")
        for what, title in rows
        for which, label in columns
    ]
    return rrb.Grid(*views, grid_columns=len(columns))


def _losses() -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin="loss", name="Losses", plot_legend=rrb.Corner2D.RightTop)


def _buffer() -> rrb.Tabs:
    def plot(name: str, *entities: str, axis: rrb.ScalarAxis | None = None) -> rrb.TimeSeriesView:
        contents = [f"/buffer/{entity}" for entity in entities]
        return rrb.TimeSeriesView(
            origin="buffer",
            contents=contents,
            name=name,
            axis_y=axis,
            plot_legend=rrb.Corner2D.LeftTop,
        )

    return rrb.Tabs(
        plot("Buffer", "samples", "inserted", "evicted"),
        plot("share", "share", axis=rrb.ScalarAxis(range=(0.0, 1.0))),
        plot("places", "keyframes", "places", "water_level"),
        plot("bytes", "size_bytes"),
        active_tab=0,
    )


def _log() -> rrb.TextLogView:
    return rrb.TextLogView(
        origin="log",
        name="Log",
        columns=rrb.TextLogColumns(
            text_log_columns=[TextLogColumnKind.LogLevel, TextLogColumnKind.Body]
        ),
        # The fingerprint of every input and each keyframe's evictions are for a search.
        rows=rrb.TextLogRows(filter_by_log_level=["INFO", "WARN", "ERROR"]),
    )
