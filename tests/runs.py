"""Runs opened and asked as the commands do it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from proground_log.navigation.floor_plan import Robot
from proground_log.navigation.journey import Journey, Place, navigate_surface
from proground_log.perception.map_texts import Texts
from proground_log.query.ask import Answer, query
from proground_log.query.image_query import ImageQuery
from proground_log.query.surface import Surface, Surfaces
from proground_log.run.opened import OpenedRun


def surface_of_run(run: Path, voxel_m: float, log_path: Path | None = None) -> Surface:
    """The surface of a finished run that has meaning."""
    opened = OpenedRun.finished(run, log_path)
    opened.require_meaning()
    return Surfaces(opened).at(voxel_m)


def query_run(
    run: Path,
    names: Sequence[str],
    voxel_m: float,
    top_k: int,
    *,
    image: ImageQuery | None = None,
    texts: Texts = Texts(),
    log_path: Path | None = None,
) -> tuple[Surface, list[Answer]]:
    """The answers of a finished run."""
    surfaces = Surfaces(OpenedRun.finished(run, log_path))
    return query(surfaces, names, voxel_m, top_k, image=image, texts=texts)


def navigate_run(
    run: Path,
    start: Place,
    goal: str | Place,
    robot: Robot,
    voxel_m: float,
    log_path: Path | None = None,
) -> Journey:
    """A way on the map of a finished run."""
    surface = surface_of_run(run, voxel_m, log_path)
    return navigate_surface(surface, start, goal, robot)
