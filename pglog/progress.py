"""The progress bar of a replay, one more sink of its events."""

from __future__ import annotations

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from proground_log.events import Event, FrameDone, StepDone


def progress_bar(console: Console) -> Progress:
    """The bar that every long command shows."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
    )


class ProgressSink:
    """Shows frames done, time left and the newest losses.

    Args:
        total: frames to come.
        console: where to draw.
    """

    def __init__(self, total: int, console: Console) -> None:
        self._progress = progress_bar(console)
        self._task = self._progress.add_task("replay", total=total, note="")
        self._note = ""
        self._progress.start()

    def on_event(self, event: Event) -> None:
        """Move on with each frame."""
        if isinstance(event, StepDone):
            self._note = f"rgb {event.losses['rgb']:.4f}  sdf {event.losses['sdf']:.5f}"
        elif isinstance(event, FrameDone):
            self._progress.update(self._task, advance=1, note=self._note)

    def close(self) -> None:
        """Leave the bar as it stands."""
        self._progress.stop()
