"""What a recording shows of meaning: the task, its memory, the heads, the views, the surface."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr

from proground_log.events import (
    Event,
    FrameDone,
    MeshExtracted,
    SemanticScores,
    SemanticStatistics,
    SemanticView,
    SurfaceMeaning,
    TaskKnown,
    ViewRendered,
)
from proground_log.palette import CURVE_COLORS, NOTHING_COLOR
from proground_log.telemetry import images
from proground_log.telemetry.blueprint import HEADS, SEMANTIC_BUFFER, SEMANTIC_LOSSES
from proground_log.telemetry.columns import Moment, ScalarColumns
from proground_log.telemetry.documents import task_document
from proground_log.telemetry.surface import heat_colors, surface

LEVEL_NAMES = ("P3", "P4", "P5")
LABELS_SHOWN = 20
"""Curves of labels that are visible when the recording opens; a plot of more is no use."""


class SemanticDrawing:
    """Draws the part of events that only a replay with a task has.

    Labels are drawn as their number plus 1; 0 is background. The curves of all labels lie on one
    entity, as those of all levels do: several hundred prompts cost hardly more than one.

    Args:
        recording, scalars: where it goes.
        task: what labels mean.
    """

    def __init__(
        self, recording: rr.RecordingStream, scalars: ScalarColumns, task: TaskKnown
    ) -> None:
        self._recording, self._scalars = recording, scalars
        self._prompts = task.prompts
        self._colors = np.concatenate([[NOTHING_COLOR], task.colors]).astype(np.uint8)
        self._introduce(task)

    def on_event(self, event: Event, now: Moment) -> None:
        """Draw what an event says of meaning."""
        match event:
            case SemanticScores():
                self._on_scores(event, now)
            case FrameDone(semantics=SemanticStatistics() as statistics):
                self._on_statistics(statistics, now)
            case ViewRendered(semantics=SemanticView() as view):
                self._on_view(view, now)
            case MeshExtracted(meaning=SurfaceMeaning() as meaning):
                self._on_surface(event, meaning, now)

    def _introduce(self, task: TaskKnown) -> None:
        """All that stands for the whole recording: names and colours."""
        self._log_static("task", task_document(task))
        labels = _annotations(("background", *task.prompts), self._colors)
        self._log_static("view/input/labels", labels)
        self._log_static("view/rendered/labels", labels)
        level_colors = np.array([*CURVE_COLORS[: len(LEVEL_NAMES)], NOTHING_COLOR])
        levels = _annotations((*LEVEL_NAMES, "no supervision"), level_colors)
        self._log_static("view/rendered/scale", levels)
        plots = ("loss", SEMANTIC_LOSSES), ("heads", HEADS), ("buffer", SEMANTIC_BUFFER)
        for folder, names in plots:
            for name, color in zip(names, CURVE_COLORS, strict=False):
                lines = rr.SeriesLines(colors=color, widths=1.5, names=name)
                self._log_static(f"{folder}/{name}", lines)
        shown = [number < LABELS_SHOWN for number in range(len(task.prompts))]
        lines = rr.SeriesLines(names=task.prompts, colors=task.colors, visible_series=shown)
        self._log_static("buffer/labels", lines)
        lines = rr.SeriesLines(names=LEVEL_NAMES, colors=level_colors[: len(LEVEL_NAMES)])
        self._log_static("buffer/levels", lines)

    def _on_scores(self, scores: SemanticScores, now: Moment) -> None:
        for name in HEADS:
            percent = getattr(scores, name)
            if not math.isnan(percent):
                self._scalars.add(f"heads/{name}", now, percent)

    def _on_statistics(self, memory: SemanticStatistics, now: Moment) -> None:
        figures = {
            "semantic_samples": memory.samples,
            "semantic_share": memory.samples / memory.capacity,
            "background": memory.background,
            "regions": memory.regions,
            "semantic_inserted": memory.inserted,
            "semantic_evicted": memory.evicted,
            "semantic_bytes": memory.size_bytes,
        }
        for name, value in figures.items():
            self._scalars.add(f"buffer/{name}", now, value)
        counts = (memory.labels[prompt] for prompt in self._prompts)
        self._scalars.add("buffer/labels", now, *counts)
        self._scalars.add("buffer/levels", now, *memory.levels)

    def _on_view(self, view: SemanticView, now: Moment) -> None:
        pictures = {
            "view/input/labels": _label_image(view.observed_labels),
            "view/rendered/labels": _label_image(view.labels),
            "view/rendered/semantics": images.false_colors(view.features),
            "view/rendered/scale": rr.SegmentationImage(view.levels),
            "view/rendered/uncertainty": images.probability(view.uncertainty),
        }
        for entity, picture in pictures.items():
            now.log(self._recording, entity, picture)

    def _on_surface(self, mesh: MeshExtracted, meaning: SurfaceMeaning, now: Moment) -> None:
        # The entity's last part names the prompt.
        asked = rr.escape_entity_path_part(meaning.prompt)
        colors = {
            "semantics": self._colors[meaning.labels + 1],
            "features": meaning.features,
            f"relevance/{asked}": heat_colors(meaning.relevance),
        }
        for name, vertex_colors in colors.items():
            now.log(self._recording, f"world/map/{name}", surface(mesh, vertex_colors))

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
