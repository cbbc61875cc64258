"""What a recording shows of meaning: the task, the heads, the views, the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr

from proground_log.events import (
    Event,
    MeshExtracted,
    SemanticScores,
    SemanticView,
    SurfaceMeaning,
    TaskKnown,
    ViewRendered,
)
from proground_log.palette import CURVE_COLORS, NOTHING_COLOR
from proground_log.telemetry import images
from proground_log.telemetry.blueprint import HEADS, SEMANTIC_LOSSES
from proground_log.telemetry.columns import Moment, ScalarColumns
from proground_log.telemetry.counts import LEVEL_NAMES
from proground_log.telemetry.documents import task_document
from proground_log.telemetry.surface import coloured, heat_colors


class SemanticDrawing:
    """Draws the part of events that only a replay with a task has.

    Labels are drawn as their number plus 1; 0 is background.

    Args:
        recording, scalars: where it goes.
        task: what labels mean.
        has_steps: whether there are losses.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        scalars: ScalarColumns,
        task: TaskKnown,
        *,
        has_steps: bool,
    ) -> None:
        self._recording, self._scalars = recording, scalars
        self._colors = np.concatenate([[NOTHING_COLOR], task.colors]).astype(np.uint8)
        self._introduce(task, SEMANTIC_LOSSES if has_steps else ())

    def on_event(self, event: Event, now: Moment) -> None:
        """Draw what an event says of meaning."""
        match event:
            case SemanticScores():
                self._on_scores(event, now)
            case ViewRendered(semantics=SemanticView() as view):
                self._on_view(view, now)
            case MeshExtracted(meaning=SurfaceMeaning() as meaning):
                self._on_surface(event, meaning, now)

    def _introduce(self, task: TaskKnown, losses: Sequence[str]) -> None:
        """All that stands for the whole recording: names and colours."""
        self._log_static("task", task_document(task))
        labels = _annotations(("background", *task.prompts), self._colors)
        self._log_static("view/input/labels", labels)
        self._log_static("view/rendered/labels", labels)
        level_colors = np.array([*CURVE_COLORS[: len(LEVEL_NAMES)], NOTHING_COLOR])
        levels = _annotations((*LEVEL_NAMES, "no supervision"), level_colors)
        self._log_static("view/rendered/scale", levels)
        plots = ("loss", losses), ("heads", HEADS)
        for folder, names in plots:
            for name, color in zip(names, CURVE_COLORS, strict=False):
                lines = rr.SeriesLines(colors=color, widths=1.5, names=name)
                self._log_static(f"{folder}/{name}", lines)

    def _on_scores(self, scores: SemanticScores, now: Moment) -> None:
        for name in HEADS:
            percent = getattr(scores, name)
            if not math.isnan(percent):
                self._scalars.add(f"heads/{name}", now, percent)

    def _on_view(self, view: SemanticView, now: Moment) -> None:
        pictures: dict[str, rr.AsComponents] = {
            "view/input/labels": _label_image(view.observed_labels),
            "view/rendered/labels": _label_image(view.labels),
        }
        if view.features is not None:
            pictures["view/rendered/semantics"] = images.false_colors(view.features)
        if view.levels is not None:
            pictures["view/rendered/scale"] = rr.SegmentationImage(view.levels)
        if view.uncertainty is not None:
            pictures["view/rendered/uncertainty"] = images.probability(view.uncertainty)
        for entity, picture in pictures.items():
            now.log(self._recording, entity, picture)

    def _on_surface(self, mesh: MeshExtracted, meaning: SurfaceMeaning, now: Moment) -> None:
        # The entity's last part names the prompt.
        asked = rr.escape_entity_path_part(meaning.prompt)
        colors = {
            "semantics": self._colors[meaning.labels + 1],
            f"relevance/{asked}": heat_colors(meaning.relevance),
        }
        if meaning.features is not None:
            colors["features"] = meaning.features
        for name, vertex_colors in colors.items():
            now.log(self._recording, f"world/map/{name}", coloured(mesh, vertex_colors))

    def _log_static(self, entity: str, what: rr.AsComponents) -> None:
        self._recording.log(entity, what, static=True)


def _label_image(labels: np.ndarray) -> rr.SegmentationImage:
    """Labels int16 [h, w], -1 for background, as classes from 0."""
    return rr.SegmentationImage((labels + 1).astype(np.uint16))


def _annotations(names: tuple[str, ...], colors: np.ndarray) -> rr.AnnotationContext:
    classes = zip(names, colors.tolist(), strict=True)
    return rr.AnnotationContext(
        [rr.AnnotationInfo(number, name, color) for number, (name, color) in enumerate(classes)]
    )
