"""What an ablation leaves behind: results a seed, a table, CSV files and plots."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean, stdev

from proground_log.evaluation.semantics import score_table
from proground_log.evaluation.top_k import KS
from proground_log.files import written_whole
from replay.ablation.variants import Outcome

SMOOTHED_STEPS = 50
"""Steps that a point of a loss curve is the mean of."""


def write_outcomes(path: Path, key: str, outcomes: Mapping[str, Outcome]) -> None:
    """Keep what one seed gave, so that it is never computed twice."""
    content = {
        "key": key,
        "variants": {
            name: {"scores": score_table(o.scores), "semantic_losses": o.semantic_losses}
            for name, o in outcomes.items()
        },
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(content) + "\n")


SeedResults = dict[str, dict[str, object]]


def read_outcomes(path: Path, key: str) -> SeedResults | None:
    """What `write_outcomes` kept under this key; None where there is nothing of the kind."""
    if not path.is_file():
        return None
    content = json.loads(path.read_text())
    return content["variants"] if content["key"] == key else None


def table_rows(results: Sequence[SeedResults]) -> list[dict[str, str]]:
    """A row a variant: each figure as mean +- standard deviation over the seeds."""
    rows = []
    for name in results[0]:
        figures = {"variant": name}
        for column in columns(results):
            values = [scores(result, name)[column] for result in results]
            figures[column] = f"{mean(values):.2f}"
            if len(values) > 1:
                figures[column] += f" ± {stdev(values):.2f}"
        rows.append(figures)
    return rows


def columns(results: Sequence[SeedResults]) -> list[str]:
    """The figures of a table: Top-K over points, and Top-1 over classes."""
    first = scores(results[0], next(iter(results[0])))
    return [f"top{k}_percent" for k in KS if f"top{k}_percent" in first] + ["top1_macro_percent"]


def scores(result: SeedResults, name: str) -> dict[str, float]:
    """The scores of a variant in the results of one seed."""
    found = result[name]["scores"]
    assert isinstance(found, dict)
    return found


def write_csv(folder: Path, table: int, results: Mapping[int, SeedResults]) -> list[Path]:
    """Every figure of every seed, and every semantic loss, as CSV files."""
    figures, losses = folder / f"table{table}.csv", folder / f"table{table}_losses.csv"
    of_seeds = list(results.values())
    with written_whole(figures) as temporary, temporary.open("w", newline="") as stream:
        names = list(scores(of_seeds[0], next(iter(of_seeds[0]))))
        writer = csv.writer(stream)
        writer.writerow(["seed", "variant", *names])
        for seed, result in results.items():
            for name in result:
                own = scores(result, name)
                writer.writerow([seed, name, *(own[column] for column in names)])
    with written_whole(losses) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["seed", "variant", "step", "semantic_loss"])
        for seed, result in results.items():
            for name in result:
                for step, loss in enumerate(_losses(result, name)):
                    writer.writerow([seed, name, step, loss])
    return [figures, losses]


def draw(folder: Path, table: int, results: Mapping[int, SeedResults]) -> list[Path]:
    """Top-1 by variant, and the curves of the semantic loss (the paper's Fig. 4), as PNG."""
    from matplotlib.figure import Figure

    of_seeds = list(results.values())
    variants = list(of_seeds[0])
    bars, curves = folder / f"table{table}.png", folder / f"table{table}_losses.png"
    figure = Figure(figsize=(7, 0.45 * len(variants) + 1.2), layout="constrained")
    axes = figure.add_subplot()
    for place, name in enumerate(variants):
        values = [scores(result, name)["top1_percent"] for result in of_seeds]
        axes.barh(place, mean(values), xerr=stdev(values) if len(values) > 1 else None, capsize=3)
    axes.set_yticks(range(len(variants)), variants)
    axes.invert_yaxis()
    axes.set_xlabel(f"Top-1 accuracy in percent, mean of {len(of_seeds)} seeds")
    with written_whole(bars) as temporary:
        figure.savefig(temporary, format="png", dpi=150, metadata={"Software": None})
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name in variants:
        smooth = _smooth(_losses(of_seeds[0], name))
        axes.plot([SMOOTHED_STEPS * (n + 1) for n in range(len(smooth))], smooth, label=name)
    axes.set_xlabel("step")
    axes.set_ylabel("semantic loss")
    axes.legend()
    with written_whole(curves) as temporary:
        figure.savefig(temporary, format="png", dpi=150, metadata={"Software": None})
    return [bars, curves]


def _losses(result: SeedResults, name: str) -> list[float]:
    found = result[name]["semantic_losses"]
    assert isinstance(found, list)
    return found


def _smooth(losses: Sequence[float]) -> list[float]:
    """Means over stretches of steps."""
    starts = range(0, len(losses) - SMOOTHED_STEPS + 1, SMOOTHED_STEPS)
    return [mean(losses[start : start + SMOOTHED_STEPS]) for start in starts]
