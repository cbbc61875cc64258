"""Judging a finished run by its own log."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
from proground_log.files import written_whole
from proground_log.log.registration import Registration
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.perception.map_texts import Texts, texts_for
from proground_log.perception.texts import TextSpace
from proground_log.query.mesh import read_ply_vertices
from proground_log.query.surface import Surfaces
from proground_log.query.voxels import LOOK_VOXEL_M, OBJECTS_VOXEL_M
from proground_log.run.opened import OpenedRun


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
        voxel_m: voxels of the mesh that was compared.
        scores: figures by name; see `view_summary`, `mesh_scores`, `score_table` and
            `object_table`.
        classes: for each class that is there its points and Top-1 in percent.
        instances: how well the objects of each class are told apart; empty where the truth does not
            tell objects apart or the map has no meaning.
    """

    voxel_m: float = LOOK_VOXEL_M
    scores: dict[str, float] = field(default_factory=dict)
    classes: dict[str, tuple[int, float]] = field(default_factory=dict)
    instances: dict[str, InstanceCounts] = field(default_factory=dict)

    def merged(self, other: Evaluation) -> Evaluation:
        """Both together; of what both have, the other's."""
        return Evaluation(
            self.voxel_m,
            self.scores | other.scores,
            self.classes | other.classes,
            self.instances | other.instances,
        )

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return dataclasses.asdict(self)

    def write(self, path: Path) -> None:
        """Write it as JSON, whole or not at all."""
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(self.to_json(), indent=2) + "\n")


def evaluate_run(
    surfaces: Surfaces,
    voxel_m: float = LOOK_VOXEL_M,
    progress: Callable[[int, int], None] = lambda *_: None,
    *,
    ground_truth: GroundTruth | None = None,
    texts: Texts = Texts(),
) -> Evaluation:
    """Score a run on its held-out views, on the true mesh and on labels, as far as there are any.

    Args:
        surfaces: of a finished run, whose log is there.
        voxel_m: voxels of the map's mesh; objects are told apart on one no finer than theirs.
        progress: told the views scored and the views in all.
        ground_truth: labelled points that take the place of the log's.
        texts: embeddings of candidate names that the map does not know.
    """
    run = surfaces.run
    points, space = _labelled_points(run, ground_truth, texts)
    held_out = run.manifest.config.held_out(len(run.log))
    mesh_bytes = run.log.attachment(MESH_ATTACHMENT)
    if not held_out and mesh_bytes is None and points is None:
        raise ProgroundError(
            "there is nothing to judge it by: no frame was held out, the log has no true mesh",
            where=run.path,
            todo="replay with --hold-out-every 10",
        )
    result = Evaluation(voxel_m)
    if held_out:
        result = result.merged(_of_views(run, held_out, progress))
    if mesh_bytes is not None:
        result = result.merged(_of_mesh(surfaces, voxel_m, mesh_bytes))
        if ground_truth is None:
            result = result.merged(_of_objects(surfaces, voxel_m))
    if points is not None and space is not None:
        result = result.merged(_of_labels(surfaces, voxel_m, points, space))
    return result.merged(_of_size(run))


def _of_views(
    run: OpenedRun, held_out: list[int], progress: Callable[[int, int], None]
) -> Evaluation:
    register = Registration(run.log.calibration)
    views = []
    for sensor in run.log.frames(held_out):
        views.append(score_view(run.map, register(sensor)))
        progress(len(views), len(held_out))
    return Evaluation(scores=view_summary(views))


def _of_mesh(surfaces: Surfaces, voxel_m: float, mesh_bytes: bytes) -> Evaluation:
    vertices_m = surfaces.mesh(voxel_m).vertices_m
    return Evaluation(scores=mesh_scores(vertices_m, read_ply_vertices(mesh_bytes)))


def _of_objects(surfaces: Surfaces, voxel_m: float) -> Evaluation:
    no_meaning = surfaces.run.map.description is None
    if no_meaning or not len(surfaces.mesh(voxel_m).vertices_m):
        return Evaluation()
    found = object_scores(surfaces.at(max(voxel_m, OBJECTS_VOXEL_M)))
    if found is None:
        return Evaluation()
    return Evaluation(scores=object_table(found), instances=found.alone.classes)


def _of_labels(
    surfaces: Surfaces, voxel_m: float, points: LabelledPoints, space: TextSpace
) -> Evaluation:
    surface_m = surfaces.mesh(voxel_m).vertices_m
    top_k = semantic_scores(surfaces.run.map, points, space, surface_m)
    classes = {points.names[k]: part for k, part in top_k.per_class.items()}
    return Evaluation(scores=score_table(top_k), classes=classes)


def _of_size(run: OpenedRun) -> Evaluation:
    sizes_bytes = run.map.sizes_bytes()
    parts = {f"map_mb_{part.replace(' ', '_')}": n / 1e6 for part, n in sizes_bytes.items()}
    return Evaluation(scores={"map_mb": sum(sizes_bytes.values()) / 1e6, **parts})


def _labelled_points(
    run: OpenedRun, ground_truth: GroundTruth | None, texts: Texts
) -> tuple[LabelledPoints | None, TextSpace | None]:
    """What to judge the map's meaning by, and the texts to do it with."""
    log, description = run.log, run.map.description
    if description is None:
        if ground_truth is not None:
            raise ProgroundError(
                "the map knows no names that labels could judge",
                where=log.path,
                todo="run `pglog perceive` on the log, and replay what it gives",
            )
        return None, None
    space = texts_for(description, texts.vocabulary, texts.text_encoder)
    if ground_truth is None:
        return labelled_points_of_log(log, space), space
    files = ground_truth.mesh, ground_truth.names, ground_truth.mapping
    return labelled_points_of_files(*files, log.label_names), space
