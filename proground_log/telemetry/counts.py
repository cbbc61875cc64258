"""What a recording shows of what a mapper holds: a curve for each figure of each group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import rerun as rr

from proground_log.events import Counts, TaskKnown
from proground_log.palette import CURVE_COLORS
from proground_log.telemetry.columns import Moment, ScalarColumns

LEVEL_NAMES = ("P3", "P4", "P5")
CURVES_SHOWN = 20
"""Curves of one figure that are visible when the recording opens; a plot of more is no use."""
NOT_DRAWN = ("capacity",)
"""Figures that repeat a setting."""


class CountsDrawing:
    """Draws the counts of frames as they come.

    The curves of a figure that is several numbers lie on one entity: several hundred prompts cost
    hardly more than one.

    Args:
        recording, scalars: where it goes.
        counts: what is counted.
        task: whose prompts have colours; None where no meaning is learnt.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        scalars: ScalarColumns,
        counts: Counts,
        task: TaskKnown | None,
    ) -> None:
        self._scalars = scalars
        colors = {} if task is None else dict(zip(task.prompts, task.colors.tolist(), strict=True))
        for group, figures in counts.items():
            for number, (name, value) in enumerate(drawn(figures or {}).items()):
                if isinstance(value, Sequence | Mapping):
                    names = list(value) if isinstance(value, Mapping) else LEVEL_NAMES[: len(value)]
                    lines = rr.SeriesLines(
                        names=names,
                        colors=[colors.get(n, _color(i)) for i, n in enumerate(names)],
                        visible_series=[i < CURVES_SHOWN for i in range(len(names))],
                    )
                else:
                    lines = rr.SeriesLines(colors=_color(number), widths=1.5, names=name)
                recording.log(f"{group}/{name}", lines, static=True)

    def add(self, counts: Counts, now: Moment) -> None:
        """Draw what is held at a moment."""
        for group, figures in counts.items():
            for name, value in drawn(figures or {}).items():
                values = value.values() if isinstance(value, Mapping) else value
                row = values if isinstance(value, Sequence | Mapping) else (value,)
                if row:
                    self._scalars.add(f"{group}/{name}", now, *row)


def drawn(figures: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of a group that are drawn, and how full it is."""
    shown = {name: value for name, value in figures.items() if name not in NOT_DRAWN}
    if "samples" in figures and figures.get("capacity"):
        shown["share"] = figures["samples"] / figures["capacity"]
    return shown


def _color(number: int) -> tuple[int, int, int]:
    return CURVE_COLORS[number % len(CURVE_COLORS)]
