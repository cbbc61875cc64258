"""The page's sections on what happened over time: losses, simulated time, memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from proground_log.mapping.map_file import NeuralMap
from proground_log.palette import NOTHING_COLOR
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
        Picture(f"{name.replace('_', ' ')}, last {values[-1]:.3g}", loss_chart(values))
        for name, values in history.losses.items()
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


def memory_contents(history: History, content: NeuralMap) -> list[Content]:
    """What the mapper remembered at the end, and how it came to that."""
    buffer = history.buffer
    if not buffer:
        return [Note("No frame was mapped.")]
    frames = np.arange(len(history.samples))
    parts: list[Content] = [
        Note(
            f"Colour and geometry: {whole(buffer['samples'])} samples of at most "
            f"{whole(buffer['capacity'])}, of {whole(buffer['keyframes'])} keyframes, in "
            f"{whole(buffer['places'])} places; {buffer['size_bytes'] / 1e6:.1f} MB."
        ),
        Charts(
            [
                Picture(
                    "samples", line_chart(frames, history.samples, "frame", cap=buffer["capacity"])
                ),
                Picture("keyframes", line_chart(frames, history.keyframes, "frame")),
            ]
        ),
    ]
    memory = history.semantics
    if memory is None or content.semantics is None:
        return [*parts, Note("No memory of meaning: the log has no regions.")]
    most = max(*memory["labels"].values(), memory["background"], 1)
    task = content.semantics.description.task
    bars = [
        Bar(
            prompt,
            whole(memory["labels"][prompt]),
            memory["labels"][prompt] / most,
            hex_color(color),
        )
        for prompt, color in zip(task.all_prompts, task.prompt_colors(), strict=True)
    ]
    nothing = Bar(
        "background",
        whole(memory["background"]),
        memory["background"] / most,
        hex_color(NOTHING_COLOR),
    )
    text = (
        f"Meaning: {whole(memory['samples'])} rays of at most {whole(memory['capacity'])}, of "
        f"{whole(memory['regions'])} regions; {memory['size_bytes'] / 1e6:.1f} MB. Rays by label:"
    )
    return [*parts, Note(text), Bars([*bars, nothing])]
