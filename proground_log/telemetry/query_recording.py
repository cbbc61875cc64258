"""The rerun recording of a query: the map in the colours of each answer, with what was found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from proground_log.query.ask import Answer
from proground_log.query.surface import Surface
from proground_log.telemetry.boxes import boxes3d
from proground_log.telemetry.scene import scene_blueprint, scene_recording, scene_view
from proground_log.telemetry.surface import coloured, heat_colors
from proground_log.telemetry.upright import overview

BOX_COLOR = (255, 90, 60)
"""Apart from all of the heat's colours."""
DIMMED = 0.7
"""Brightness of what is cold."""


def draw_answers(path: Path, surface: Surface, answers: Sequence[Answer]) -> None:
    """Write an .rrd file that opens with a tab for each answer.

    Args:
        path: the file, replaced if it is there.
        surface, answers: as `query_surface` has them.
    """
    mesh, queries = surface.mesh, [answer.query for answer in answers]
    with scene_recording(path, surface, ", ".join(queries)) as recording:
        eye = overview(mesh.vertices_m, surface.up)
        recording.send_blueprint(_blueprint(queries, eye))
        for number, answer in enumerate(answers):
            heat = np.clip(answer.scores / answer.measure.full, 0, 1)
            glowing = coloured(mesh, _glowing(mesh.colors, heat))
            recording.log(f"world/map/relevance/{number}", glowing, static=True)
            labels = [f"{answer.query} {thing.score:.2f}" for thing in answer.things]
            boxes = boxes3d([thing.box for thing in answer.things], labels, BOX_COLOR)
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
        scene_view(query, [f"+ $origin/map/relevance/{number}", f"+ $origin/found/{number}"], eye)
        for number, query in enumerate(queries)
    ]
    return scene_blueprint(rrb.Tabs(*views, active_tab=0))
