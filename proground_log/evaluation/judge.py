"""Judging a finished run by its own log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.evaluation.instance_scores import InstanceCounts
from proground_log.evaluation.objects import object_scores, object_table
from proground_log.evaluation.reconstruction import mesh_scores, score_view, view_summary
from proground_log.evaluation.semantics import (
    LabelledPoints,
    labelled_points_of_files,
    labelled_points_of_log,
    score_table,
    semantic_scores,
)
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.mapping.map_file import NeuralMap, load_map
from proground_log.perception.map_texts import Texts, texts_for
from proground_log.perception.texts import TextSpace
from proground_log.query.mesh import extract_mesh, read_ply_vertices
from proground_log.query.surface import VOXEL_M, surface_of
from proground_log.run.folder import RunFolder
from proground_log.run.manifest import Manifest, open_log_of


@dataclass(frozen=True)
class GroundTruth:
    """A truth that is not the log's own.

    Args:
        mesh: PLY whose vertices have labels.
        names: candidate names.
        mapping: what the log's class names are called among them, where they differ.
    """

    mesh: Path
    names: Path
    mapping: Path | None = None


@dataclass(frozen=True)
class Evaluation:
    """How good a map is.

    Args:
        scores: figures by name; see `view_summary`, `mesh_scores`, `score_table` and
            `object_table`.
        classes: for each class that is there its points and Top-1 in percent.
        instances: how well the objects of each class are told apart; empty where the truth does not
            tell objects apart or the map has no meaning.
    """

    scores: dict[str, float]
    classes: dict[str, tuple[int, float]]
    instances: dict[str, InstanceCounts] = field(default_factory=dict)


def evaluate_run(
    run_path: Path,
    log_path: Path | None,
    voxel_m: float,
    progress: Callable[[int, int], None],
    *,
    ground_truth: GroundTruth | None = None,
    texts: Texts = Texts(),
) -> Evaluation:
    """Score a run on its held-out views, on the true mesh and on labels, as far as there are any.

    Args:
        run_path: folder of a finished run.
        log_path: its log, or None where it is where the run found it.
        voxel_m: voxels of the map's mesh; objects are told apart on one no finer than theirs.
        progress: told the views scored and the views in all.
        ground_truth: labelled points that take the place of the log's.
        texts: embeddings of candidate names that the map does not know.
    """
    run = RunFolder(run_path).require_finished()
    manifest = Manifest.read(run.manifest)
    reader = open_log_of(manifest, log_path)
    content = load_map(run.map)
    points, space = _labelled_points(content, reader, ground_truth, texts)
    held_out = manifest.config.held_out(len(reader))
    mesh_bytes = reader.attachment(MESH_ATTACHMENT)
    if not held_out and mesh_bytes is None and points is None:
        raise ProgroundError(
            "there is nothing to judge it by: no frame was held out, the log has no true mesh",
            where=run_path,
            todo="replay with --hold-out-every 10",
        )
    scores: dict[str, float] = {}
    classes: dict[str, tuple[int, float]] = {}
    instances: dict[str, InstanceCounts] = {}
    if held_out:
        register = Registration(reader.calibration)
        views = []
        for sensor in reader.frames(held_out):
            views.append(score_view(content, register(sensor)))
            progress(len(views), len(held_out))
        scores |= view_summary(views)
    if mesh_bytes is not None or points is not None:
        mesh = extract_mesh(content, voxel_m)
        if mesh_bytes is not None:
            scores |= mesh_scores(mesh.vertices_m, read_ply_vertices(mesh_bytes))
            if content.semantics is not None and ground_truth is None and len(mesh.vertices_m):
                found = object_scores(surface_of(run, content, max(voxel_m, VOXEL_M), reader))
                scores |= {} if found is None else object_table(found)
                instances = {} if found is None else found.alone.classes
        if points is not None and space is not None:
            top_k = semantic_scores(content, points, space, mesh.vertices_m)
            scores |= score_table(top_k)
            classes = {points.names[k]: part for k, part in top_k.per_class.items()}
    sizes_bytes = content.sizes_bytes()
    scores["map_mb"] = sum(sizes_bytes.values()) / 1e6
    for part, size_bytes in sizes_bytes.items():
        scores[f"map_mb_{part.replace(' ', '_')}"] = size_bytes / 1e6
    return Evaluation(scores, classes, instances)


def _labelled_points(
    content: NeuralMap, reader: LogReader, ground_truth: GroundTruth | None, texts: Texts
) -> tuple[LabelledPoints | None, TextSpace | None]:
    """What to judge the map's semantics by, and the texts to do it with."""
    if content.semantics is None:
        if ground_truth is not None:
            raise ProgroundError(
                "the map knows no names that labels could judge",
                where=reader.path,
                todo="run `pglog perceive` on the log, and replay what it gives",
            )
        return None, None
    space = texts_for(content.semantics.description, texts.vocabulary, texts.text_encoder)
    if ground_truth is None:
        return labelled_points_of_log(reader, space), space
    files = ground_truth.mesh, ground_truth.names, ground_truth.mapping
    return labelled_points_of_files(*files, reader.label_names), space
