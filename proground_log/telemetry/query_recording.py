"""The rerun recording of a query: the map in the colours of each answer, with what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from proground_log.events import MeshExtracted
from proground_log.files import file_sha256
from proground_log.log.upright import nearest_axis
from proground_log.query.ask import Answer
from proground_log.query.boxes import OrientedBox
from proground_log.query.surface import Surface
from proground_log.telemetry.blueprint import BACKGROUND
from proground_log.telemetry.boxes import boxes3d
from proground_log.telemetry.rerun_sink import recording_written
from proground_log.telemetry.surface import heat_colors, surface
from proground_log.telemetry.upright import VIEW_COORDINATES, overview

BOX_COLOR = (255, 90, 60)
"""Apart from all of the heat's colours."""
DIMMED = 0.7
"""Brightness of what is cold."""


@dataclass(frozen=True)
class QueryDrawing:
    """What is drawn of an answer.

    Args:
        query: what was looked for.
        heat: float [V] in [0, 1], of the mesh's vertices; 0 is what the query leaves cold.
        boxes: of the N things found.
        labels: theirs.
    """

    query: str
    heat: np.ndarray
    boxes: Sequence[OrientedBox]
    labels: list[str]


def write_query_recording(
    path: Path,
    recording_id: str,
    mesh: MeshExtracted,
    drawings: Sequence[QueryDrawing],
    up: np.ndarray,
) -> None:
    """Write an .rrd file that opens with a tab for each query.

    Args:
        path: the file, replaced if it is there.
        recording_id: tells it from others in one viewer.
        mesh: the map's surface.
        drawings: one a query.
        up: the world's upward direction [3].
    """
    with recording_written(path, recording_id) as recording:
        eye = overview(mesh.vertices_m, up)
        recording.send_blueprint(_blueprint([drawing.query for drawing in drawings], eye))
        recording.log("world", VIEW_COORDINATES[nearest_axis(up)], static=True)
        for number, drawing in enumerate(drawings):
            colors = _glowing(mesh.colors, drawing.heat)
            recording.log(f"world/map/relevance/{number}", surface(mesh, colors), static=True)
            boxes = boxes3d(drawing.boxes, drawing.labels, BOX_COLOR)
            recording.log(f"world/found/{number}", boxes, static=True)


def _glowing(colors: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Heat [V] as colours uint8 [V, 3] over a dim, grey map, so that one still knows the place.

    The root lets another name for a thing show too, whose relevance is low.
    """
    share = np.sqrt(heat)[:, None]
    gray = DIMMED * colors.mean(axis=1, keepdims=True)
    return ((1 - share) * gray + share * heat_colors(heat)).round().astype(np.uint8)


def _blueprint(queries: Sequence[str], eye: rrb.EyeControls3D) -> rrb.Blueprint:
    views = [
        rrb.Spatial3DView(
            origin="world",
            contents=[f"+ $origin/map/relevance/{number}", f"+ $origin/found/{number}"],
            name=query,
            background=rrb.Background(color=BACKGROUND),
            line_grid=rrb.LineGrid3D(visible=False),
            eye_controls=eye,
        )
        for number, query in enumerate(queries)
    ]
    return rrb.Blueprint(
        rrb.Tabs(*views, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
    )


def draw_answers(path: Path, surface: Surface, answers: Sequence[Answer]) -> None:
    """Write a rerun recording with a tab for each answer.

    Args:
        path: the .rrd file, replaced if it is there.
        surface, answers: as `query_run` gives them.
    """
    mesh = surface.mesh
    drawings = [
        QueryDrawing(
            query=answer.query,
            heat=np.clip(answer.scores / answer.measure.full, 0, 1),
            boxes=[thing.box for thing in answer.things],
            labels=[f"{answer.query} {thing.instance.score:.2f}" for thing in answer.things],
        )
        for answer in answers
    ]
    extracted = MeshExtracted(0, mesh.vertices_m, mesh.faces, mesh.normals, mesh.colors)
    queries = ", ".join(answer.query for answer in answers)
    recording_id = f"{file_sha256(surface.run.map)[:16]}: {queries}"
    write_query_recording(path, recording_id, extracted, drawings, surface.up)
