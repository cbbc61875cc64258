"""Texts of a recording: the summary and the task, as markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import rerun as rr

from proground_log.events import TaskKnown


def summary_document(summary: dict[str, object]) -> rr.TextDocument:
    """The summary as a markdown table; a nested record becomes a table of its own."""
    plain = {name: value for name, value in summary.items() if not isinstance(value, dict)}
    nested = {name: value for name, value in summary.items() if isinstance(value, dict)}
    sections = ["# Summary\n" + _figures(plain)]
    sections += [f"## {name}\n" + _figures(value) for name, value in nested.items()]
    return _markdown("\n".join(sections))


def task_document(task: TaskKnown) -> rr.TextDocument:
    """The task's prompts as a markdown table, with the numbers and colours of their labels."""
    rows = [
        (number, prompt, f"`#{bytes(color.tolist()).hex()}`")
        for number, (prompt, color) in enumerate(zip(task.prompts, task.colors, strict=True), 1)
    ]
    return _markdown(f"# Task: {task.name}\n" + _table(("label", "prompt", "colour"), rows))


def _markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _figures(figures: dict[str, object]) -> str:
    rows = ((name.replace("_", " "), value) for name, value in figures.items())
    return _table(("figure", "value"), rows)


def _table(titles: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [titles, ["---"] * len(titles), *rows]
    return "".join(f"| {' | '.join(map(_cell, line))} |\n" for line in lines)


def _cell(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")
