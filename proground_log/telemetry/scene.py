"""Recordings that show one surface: what those of objects, answers and ways have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from proground_log.log.upright import nearest_axis
from proground_log.query.surface import Surface
from proground_log.telemetry.blueprint import BACKGROUND
from proground_log.telemetry.rerun_sink import recording_written
from proground_log.telemetry.upright import VIEW_COORDINATES


@contextmanager
def scene_recording(path: Path, surface: Surface, title: str) -> Iterator[rr.RecordingStream]:
    """Give a recording to fill, upright; it is written once it is full.

    Args:
        path: the .rrd file, replaced if it is there.
        surface: what is shown; with the title it tells the recording from others in one viewer.
        title: what is shown of it.
    """
    with recording_written(path, f"{surface.run.map_sha256[:16]}: {title}") as recording:
        up = VIEW_COORDINATES[nearest_axis(surface.up)]
        recording.log("world", up, static=True)
        yield recording


def scene_view(
    name: str, contents: Sequence[str] = ("$origin/**",), eye: rrb.EyeControls3D | None = None
) -> rrb.Spatial3DView:
    """A view of the scene, with nothing but what is in it."""
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=eye,
    )


def scene_blueprint(
    views: rrb.Container | rrb.View, *, timeline: str | None = None
) -> rrb.Blueprint:
    """A layout of such views alone."""
    return rrb.Blueprint(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline),
    )
