"""The page's sections on what happened over time: losses, simulated time, memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from proground_log.palette import NOTHING_COLOR
from proground_log.perception.description import PerceptionDescription
from proground_log.report.figures import (
    hex_color,
    line_chart,
    loss_chart,
    stage_chart,
    stage_color,
)
from proground_log.report.page import (
    Bar,
    Bars,
    Charts,
    Content,
    Figures,
    Legend,
    Note,
    Picture,
    Table,
    whole,
)
from proground_log.run.history import History
from proground_log.run.manifest import Manifest


def loss_contents(history: History) -> list[Content]:
    """Every loss over the steps."""
    if not history.losses:
        return [Note("No step was done.")]
    charts = [
        Picture(f"{name.replace('_', ' ')}, last {known[-1]:.3g}", loss_chart(known))
        for name, values in history.losses.items()
        # A term may begin after the first step.
        if len(known := values[~np.isnan(values)])
    ]
    return [
        Note(
            "Each term before its weight, and the weighted total. Line: mean over a stretch of "
            "steps; band: where four fifths of its steps lie."
        ),
        Charts(charts),
    ]


def budget_contents(manifest: Manifest, history: History) -> list[Content]:
    """What the scheduler did: curves where time was short, always the totals."""
    settings, result = manifest.config.simulation, manifest.result or {}
    simulated: dict[str, Any] = dict(result.get("simulation", {}))  # type: ignore[call-overload]
    machine: dict[str, Any] = dict(result.get("machine s", {}))  # type: ignore[call-overload]
    rows = [
        (
            stage,
            f"{simulated.pop(f'{stage} s'):.1f} s" if f"{stage} s" in simulated else "",
            f"{seconds:.1f} s",
        )
        for stage, seconds in machine.items()
    ]
    rows.append(("idle", f"{simulated.pop('idle s', 0):.1f} s", ""))
    stages = Table(("stage", f"simulated: {manifest.cost_model.name}", "this machine"), rows)
    totals = Figures([(name, f"{value:,}") for name, value in simulated.items()])
    if settings.budget_ms is None and settings.speed == 0:
        text = (
            f"No budget: every mapped frame got {manifest.config.steps} steps, and the next one "
            "came when the mapper was free."
        )
        return [Note(text), stages]
    charts = [
        Picture(
            "spent by stage, ms a frame",
            stage_chart(history.done_s, history.spent_ms, "simulated s", cap=settings.budget_ms),
        ),
        Picture("steps a frame", line_chart(history.done_s, history.steps, "simulated s")),
        Picture("lag, s", line_chart(history.done_s, history.lag_s, "simulated s")),
        Picture(
            "frames waiting",
            line_chart(history.done_s, history.waiting, "simulated s", cap=settings.queue),
        ),
        Picture(
            "frames dropped so far",
            line_chart(
                np.append(0.0, history.dropped_s),
                np.arange(len(history.dropped_s) + 1),
                "simulated s",
            ),
        ),
    ]
    budget = "no budget" if settings.budget_ms is None else f"{settings.budget_ms:g} ms a frame"
    text = (
        f"{budget}, frames at {settings.speed:g} times the recorded speed, a queue of "
        f"{settings.queue}, {settings.overrun}. Dashed: the budget, and the queue."
    )
    legend = Legend([(stage, stage_color(stage)) for stage in history.spent_ms])
    return [Note(text[0].upper() + text[1:]), Charts(charts), legend, stages, totals]


def memory_contents(history: History, description: PerceptionDescription | None) -> list[Content]:
    """What the mapper held at the end, group by group, and how it came to that.

    Args:
        history: of the run.
        description: whose prompts have colours; None where the map knows no meaning.
    """
    colors: dict[str, str] = {}
    if description is not None:
        task = description.task
        colors = dict(zip(task.all_prompts, map(hex_color, task.prompt_colors()), strict=True))
    if not history.held:
        return [Note("No frame was mapped.")]
    parts: list[Content] = []
    for group, figures in history.held.items():
        parts += _group_contents(group, figures, history.counts[group], colors)
    if description is None:
        parts.append(Note("No memory of meaning: the log has no regions."))
    return parts


def _group_contents(
    group: str,
    figures: Mapping[str, Any],
    curves: Mapping[str, np.ndarray],
    colors: Mapping[str, str],
) -> list[Content]:
    rows = [(_title(name), _figure(name, value)) for name, value in figures.items() if _is(value)]
    parts: list[Content] = [Note(f"{group.capitalize()}:"), Figures(rows)]
    capacity = figures.get("capacity")
    charts = [
        Picture(
            _title(name),
            line_chart(
                np.arange(len(values)),
                values,
                "frame",
                cap=capacity if name == "samples" else None,
            ),
        )
        for name, values in curves.items()
        if values.min() < values.max()
    ]
    if charts:
        parts.append(Charts(charts))
    for name, value in figures.items():
        if isinstance(value, Mapping) and value:
            most = max(*value.values(), 1)
            bars = [
                Bar(each, whole(number), number / most, colors.get(each, hex_color(NOTHING_COLOR)))
                for each, number in value.items()
            ]
            parts += [Note(f"{group.capitalize()}, {_title(name)}:"), Bars(bars)]
    return parts


def _is(value: object) -> bool:
    """Whether a figure is one number."""
    return isinstance(value, int)


def _title(name: str) -> str:
    return name.removesuffix("_bytes").replace("_", " ")


def _figure(name: str, value: int) -> str:
    return f"{value / 1e6:.1f} MB" if name.endswith("_bytes") else whole(value)
