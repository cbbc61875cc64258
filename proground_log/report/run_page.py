"""A finished run as a web page: what its files say, laid out for a reader."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from proground_log.errors import ProgroundError
from proground_log.evaluation.judge import Evaluation, evaluate_run
from proground_log.files import require_free, written_whole
from proground_log.log.reader import LogReader
from proground_log.mapping.map import Map
from proground_log.query.surface import Surfaces
from proground_log.report.curves import budget_contents, loss_contents, memory_contents
from proground_log.report.page import (
    Bar,
    Bars,
    Commands,
    Content,
    Figures,
    Note,
    Page,
    Section,
    Tile,
    render_page,
    whole,
)
from proground_log.report.things import thing_sections
from proground_log.report.views import view_contents
from proground_log.run.manifest import Manifest
from proground_log.run.opened import OpenedRun
from proground_log.run.settings import flags

VERDICT = (
    ("psnr_db", "Colour (PSNR)", "dB", ".1f"),
    ("ssim", "Structure (SSIM)", "of 1", ".2f"),
    ("depth_l1_cm", "Depth error", "cm", ".1f"),
    ("completion_percent", "Surface found", "%", ".0f"),
    ("top1_percent", "Right names", "%", ".0f"),
)
"""Scores that the page opens with, as far as there are any."""


def write_report(
    run_path: Path,
    output: Path,
    log_path: Path | None,
    progress: Callable[[int, int], None],
    *,
    overwrite: bool,
) -> None:
    """Write the page of a run; the same run gives the same bytes.

    Args:
        run_path: folder of a finished run.
        output: the page (.html).
        log_path: its log, or None where it is where the run found it.
        progress: told the views scored and the views in all.
        overwrite: replace a page that is there.

    Raises:
        ProgroundError: the run is not finished, its log is not there or is another one, or the
            page cannot be written.
    """
    require_free(output, overwrite=overwrite)
    html = render_page(page_of(run_path, log_path, progress))
    with written_whole(output) as temporary:
        temporary.write_text(html, encoding="utf-8")


def page_of(run_path: Path, log_path: Path | None, progress: Callable[[int, int], None]) -> Page:
    """The page of a run; see `write_report`."""
    run = OpenedRun.finished(run_path, log_path)
    manifest, reader, history = run.manifest, run.log, run.history
    surfaces = Surfaces(run)
    try:
        judged, why_not = evaluate_run(surfaces, progress=progress), ""
    except ProgroundError as error:
        judged, why_not = Evaluation(), f"Not judged: {error.what}; {error.todo}."
    result = manifest.result or {}
    task = f"{result['task']} in " if "task" in result else ""
    return Page(
        title=f"{task}{reader.path.name}",
        facts=_facts(manifest, run.path, reader),
        tiles=_tiles(judged, result),
        sections=[
            Section("Views", view_contents(run)),
            Section("Quality", _quality(judged, why_not)),
            *thing_sections(surfaces),
            Section("Losses", loss_contents(history)),
            Section("Simulated time", budget_contents(manifest, history)),
            Section("Memory", memory_contents(history, run.map.description)),
            Section("Map", _map(run.map)),
            Section("How it was made", _made(run)),
        ],
    )


def _facts(manifest: Manifest, run: Path, reader: LogReader) -> list[str]:
    given = [" ".join(flag) for flag in flags(manifest.config)]
    return [
        f"run {run.resolve().name}/",
        f"{reader.recording.source} recorded as {reader.recording.format}, {len(reader)} frames",
        f"pglog {manifest.code_version} on {manifest.machine['device']}",
        ", ".join(given) or "default settings",
    ]


def _tiles(judged: Evaluation, result: dict[str, Any]) -> list[Tile]:
    tiles = [
        Tile(name, f"{judged.scores[key]:{form}}", unit)
        for key, name, unit, form in VERDICT
        if key in judged.scores
    ]
    tiles += [
        Tile(
            "Frames mapped",
            whole(result["frames mapped"]),
            f"of {whole(result['frames arrived'])}",
        ),
        Tile("Frames dropped", whole(result["frames dropped"])),
        *([Tile("Steps", whole(result["steps"]))] if "steps" in result else []),
        Tile("Map", f"{result['map MB']:.1f}", "MB"),
    ]
    return tiles


def _quality(judged: Evaluation, why_not: str) -> list[Content]:
    if why_not:
        return [Note(why_not)]
    sizes = [name for name in judged.scores if name.startswith("map_mb")]
    scores = {name: value for name, value in judged.scores.items() if name not in sizes}
    rows = [
        (name.replace("_", " "), whole(int(value)) if value == int(value) else f"{value:.2f}")
        for name, value in scores.items()
    ]
    parts: list[Content] = [Figures(rows)]
    if not judged.classes:
        return [*parts, Note("No accuracy by class: the log has no labels, or the map no meaning.")]
    order = sorted(judged.classes.items(), key=lambda item: (-item[1][0], item[0]))
    bars = [
        Bar(name, f"{top1:.1f} % of {whole(points)}", top1 / 100) for name, (points, top1) in order
    ]
    return [
        *parts,
        Note("Top-1 by class, and points judged; the class with most points first:"),
        Bars(bars),
    ]


def _map(mapped: Map) -> list[Content]:
    sizes = mapped.sizes_bytes()
    most, size_m = max(sizes.values()), mapped.bounds.size_m
    bars = [Bar(part, f"{size / 1e3:,.1f} kB", size / most) for part, size in sizes.items()]
    text = (
        f"{sum(sizes.values()) / 1e6:.2f} MB for {' x '.join(f'{side:.1f}' for side in size_m)} m."
    )
    return [Note(text), Bars(bars)]


def _made(run: OpenedRun) -> list[Content]:
    manifest = run.manifest
    log, name = shlex.quote(run.log.path.name), shlex.quote(run.path.resolve().name)
    given = shlex.join(word for flag in flags(manifest.config) for word in flag)
    packages = ", ".join(f"{package} {found}" for package, found in manifest.packages.items())
    parts: list[Content] = [
        Commands(
            [
                f"pglog replay {log} -o {name} {given}".rstrip(),
                f"pglog replay --manifest {name}/manifest.json -o again --check",
                f"pglog evaluate {name}",
                f"pglog view {name}",
            ]
        )
    ]
    if run.map.description is not None and run.log.task is None:
        parts.append(Note("It perceived as it went: give the same perception options again."))
    return [*parts, Note(f"The log's sha256 is {manifest.log_sha256}. {packages}.")]
