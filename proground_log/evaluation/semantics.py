"""Judging what a map says things are: Top-K accuracy at labelled points (paper 5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from proground_log.errors import ProgroundError
from proground_log.evaluation.label_lists import (
    candidates_of,
    read_labelled_mesh,
    read_mapping,
    read_names,
    truth_of,
)
from proground_log.evaluation.top_k import TopK, accuracy_of_ranks, truth_ranks
from proground_log.files import require_file
from proground_log.log.reader import LogReader
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.mapping.map import Map
from proground_log.perception.texts import TextSpace

POINTS_AT_ONCE = 32768
BACKGROUND = ("wall", "floor", "ceiling", "void")
"""Labels of a log that are not judged: the paper leaves them out with more of their kind."""


@dataclass(frozen=True)
class LabelledPoints:
    """The truth.

    Args:
        points_m: float64 [V, 3], world axes.
        truth: int64 [V], number of the candidate; -1 for points that are not judged.
        names: the candidates.
    """

    points_m: np.ndarray
    truth: np.ndarray
    names: tuple[str, ...]


def labelled_points_of_log(reader: LogReader, texts: TextSpace) -> LabelledPoints | None:
    """The points of a log's own mesh; None where it has none with labels.

    The candidates are the log's classes without walls, floor and ceiling, as far as the texts
    know them.
    """
    mesh = reader.attachment(MESH_ATTACHMENT)
    if mesh is None or not reader.label_names:
        return None
    label_names = {label: name for label, name in reader.label_names.items() if label > 0}
    names = [
        name
        for name in dict.fromkeys(label_names.values())
        if name.lower() not in BACKGROUND and _knows(texts, name)
    ]
    points_m, labels, _ = read_labelled_mesh(mesh, where=reader.path)
    candidates = candidates_of(label_names, names, excluded=())
    return LabelledPoints(points_m, truth_of(labels, candidates), tuple(names))


def labelled_points_of_files(
    mesh: Path, names: Path, mapping: Path | None, label_names: dict[int, str]
) -> LabelledPoints:
    """The paper's protocol: points of a mesh file, candidates of a list of names.

    Args:
        mesh: PLY whose vertices have labels.
        names: the candidates, such as the 894 names of NYUv2.
        mapping: what the labels' names are called among them.
        label_names: names by label, as the log has them; where it has none, labels count the
            lines of `names` from 1.
    """
    candidates = read_names(names)
    points_m, labels, _ = read_labelled_mesh(require_file(mesh).read_bytes(), where=mesh)
    named = label_names or dict(enumerate(candidates, start=1))
    found = candidates_of(named, candidates, read_mapping(mapping) if mapping else None)
    return LabelledPoints(points_m, truth_of(labels, found), candidates)


def _knows(texts: TextSpace, name: str) -> bool:
    try:
        texts.embed([name])
    except ProgroundError:
        return False
    return True


def semantic_scores(
    mapped: Map, points: LabelledPoints, texts: TextSpace, surface_m: np.ndarray
) -> TopK:
    """Ask the map at the points themselves and score its answers.

    Args:
        mapped: a map with meaning.
        points: the truth.
        texts: where the candidates' names are looked up.
        surface_m: [S, 3] the map's vertices, for the coverage.
    """
    embeddings = texts.embed(points.names)
    judged = np.flatnonzero(points.truth >= 0)
    ranks = np.full(len(points.truth), -1)
    for start in range(0, len(judged), POINTS_AT_ONCE):
        rows = judged[start : start + POINTS_AT_ONCE]
        logits, _ = mapped.ask(points.points_m[rows], embeddings)
        ranks[rows] = truth_ranks(logits, points.truth[rows])
    distances_m = np.full(len(points.truth), np.inf)
    if len(surface_m):
        distances_m = np.asarray(cKDTree(surface_m).query(points.points_m)[0])
    return accuracy_of_ranks(ranks, points.truth, len(points.names), distances_m=distances_m)


def score_table(scores: TopK) -> dict[str, float]:
    """The figures by name, percent but for the area."""
    table = {f"top{k}_percent": value for k, value in scores.micro.items()}
    table |= {f"top{k}_macro_percent": value for k, value in scores.macro.items()}
    table["top_k_area"] = scores.area
    if scores.coverage is not None:
        table["coverage_percent"] = scores.coverage
    table["judged_points"] = float(scores.points)
    table["candidate_names"] = float(scores.candidates)
    return table
