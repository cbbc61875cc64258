"""What a sweep leaves behind beside its cells: a table, CSV, JSON and plots."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from statistics import mean, stdev

from proground_log.files import written_whole
from proground_log.run.settings import shown
from replay.sweep.cells import Result

FIGURES = {
    "top1_percent": "Top-1 %",
    "psnr_db": "PSNR dB",
    "ssim": "SSIM",
    "depth_l1_cm": "depth L1 cm",
    "frames_dropped": "frames dropped",
}
"""What is tabulated and drawn against the budget, as far as there is any."""


def table_rows(results: Sequence[Result]) -> list[dict[str, str]]:
    """A row for each budget and setting: figures as mean ± standard deviation over the seeds."""
    columns = figures_of(results)
    if any("steps" in result.figures for result in results):
        columns["steps"] = "steps"
    rows = []
    for group in _same_but_for_seed(results):
        given = group[0].cell.settings
        row = {
            "budget ms": shown(group[0].cell.budget_ms),
            **{key: shown(value) for key, value in given.items()},
        }
        for key, title in columns.items():
            row[title] = _spread([r.figures[key] for r in group if key in r.figures])
        failed = [str(result.cell.config.seed) for result in group if result.error is not None]
        row["failed seeds"] = ", ".join(failed)
        rows.append(row)
    if not any(row["failed seeds"] for row in rows):
        for row in rows:
            del row["failed seeds"]
    return rows


def errors_of(results: Sequence[Result]) -> dict[str, str]:
    """Why cells failed, by name, in a line each: of a traceback the last."""
    failed = {result.cell.name: result.error for result in results if result.error is not None}
    return {name: error.strip().splitlines()[-1] for name, error in failed.items()}


def figures_of(results: Sequence[Result]) -> dict[str, str]:
    """The titles of the figures that there are."""
    return {
        key: title
        for key, title in FIGURES.items()
        if any(key in result.figures for result in results)
    }


def write_tables(folder: Path, log_sha256: str, results: Sequence[Result]) -> list[Path]:
    """Every figure of every cell, as sweep.csv and sweep.json."""
    settings = list(results[0].cell.settings)
    names = list(dict.fromkeys(name for result in results for name in result.figures))
    as_csv, as_json = folder / "sweep.csv", folder / "sweep.json"
    with written_whole(as_csv) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["cell", "budget_ms", "seed", *settings, *names, "error"])
        for result in results:
            cell = result.cell
            given = [shown(value) for value in cell.settings.values()]
            figures = [result.figures.get(name, "") for name in names]
            row = [cell.name, shown(cell.budget_ms), cell.config.seed, *given, *figures]
            writer.writerow([*row, result.error or ""])
    cells = [
        {
            "cell": result.cell.name,
            "budget_ms": result.cell.budget_ms,
            "seed": result.cell.config.seed,
            "settings": result.cell.settings,
            "figures": result.figures,
            "error": result.error,
        }
        for result in results
    ]
    with written_whole(as_json) as temporary:
        temporary.write_text(
            json.dumps({"log_sha256": log_sha256, "cells": cells}, indent=2) + "\n"
        )
    return [as_csv, as_json]


def draw(folder: Path, results: Sequence[Result]) -> list[Path]:
    """Each figure against the budget, a line for each setting, as PNG.

    A point is the mean over the seeds, its bar the standard deviation.
    """
    from matplotlib.figure import Figure

    paths = []
    for key, title in figures_of(results).items():
        figure = Figure(figsize=(6, 4), layout="constrained")
        axes = figure.add_subplot()
        for label, groups in _curves(results).items():
            found = {
                group[0].cell.budget_ms: [r.figures[key] for r in group if key in r.figures]
                for group in groups
            }
            points = {budget_ms: values for budget_ms, values in sorted(found.items()) if values}
            means = [mean(values) for values in points.values()]
            spreads = [stdev(values) if len(values) > 1 else 0.0 for values in points.values()]
            axes.errorbar(list(points), means, spreads, marker="o", capsize=3, label=label)
        budgets_ms = sorted({result.cell.budget_ms for result in results})
        axes.set_xscale("log")
        axes.set_xticks(budgets_ms, [shown(budget_ms) for budget_ms in budgets_ms])
        axes.minorticks_off()
        axes.set_xlabel("budget of a frame in ms")
        axes.set_ylabel(title)
        if results[0].cell.settings:
            axes.legend()
        paths.append(folder / f"sweep_{key}.png")
        with written_whole(paths[-1]) as temporary:
            figure.savefig(temporary, format="png", dpi=150, metadata={"Software": None})
    return paths


def _same_but_for_seed(results: Sequence[Result]) -> list[list[Result]]:
    """The results that a figure is the mean of."""
    groups: dict[tuple[object, ...], list[Result]] = {}
    for result in results:
        cell = result.cell
        groups.setdefault((cell.budget_ms, *cell.settings.values()), []).append(result)
    return list(groups.values())


def _curves(results: Sequence[Result]) -> dict[str, list[list[Result]]]:
    """For each setting, by its name in a legend, the results of every budget."""
    curves: dict[str, list[list[Result]]] = {}
    for group in _same_but_for_seed(results):
        given = group[0].cell.settings.items()
        label = "\n".join(f"{key} {shown(value)}" for key, value in given)
        curves.setdefault(label, []).append(group)
    return curves


def _spread(values: Sequence[float]) -> str:
    """Mean and standard deviation; a dash where there is no value."""
    if not values:
        return "–"
    return f"{mean(values):.2f}" + (f" ± {stdev(values):.2f}" if len(values) > 1 else "")
