"""Judging a finished run by its own log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.evaluation.reconstruction import mesh_scores, score_view, view_summary
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.mapping.map_file import load_map
from proground_log.query.surface import extract_mesh, read_ply_vertices
from replay.config import ReplayConfig
from replay.manifest import Manifest, file_sha256
from replay.run_folder import RunFolder


def held_out_frames(config: ReplayConfig, count: int) -> list[int]:
    """Numbers of the frames that a replay of a log of `count` frames kept from the mapper."""
    every = config.hold_out_every
    chosen = config.selection.of(count)[: config.max_frames]
    return list(chosen[every - 1 :: every]) if every else []


def evaluate_run(
    run_path: Path,
    log_path: Path | None,
    voxel_m: float,
    progress: Callable[[int, int], None],
) -> dict[str, float]:
    """Score a run on its held-out views, and on the true mesh where its log has one.

    Args:
        run_path: folder of a finished run.
        log_path: its log, or None where it is where the run found it.
        voxel_m: voxels of the map's mesh.
        progress: told the views scored and the views in all.

    Returns:
        Scores by name; see `view_summary` and `mesh_scores`, and "map_mb".
    """
    run = RunFolder(run_path).require_finished()
    manifest = Manifest.read(run.manifest)
    reader = LogReader(log_path or Path(manifest.log_path))
    if file_sha256(reader.path) != manifest.log_sha256:
        raise ProgroundError(
            "is not the log that the run was made of", where=reader.path, todo="give it with --log"
        )
    content = load_map(run.map)
    held_out = held_out_frames(manifest.config, len(reader))
    mesh_bytes = reader.attachment(MESH_ATTACHMENT)
    if not held_out and mesh_bytes is None:
        raise ProgroundError(
            "there is nothing to judge it by: no frame was held out, the log has no true mesh",
            where=run_path,
            todo="replay with --hold-out-every 10",
        )
    scores: dict[str, float] = {}
    if held_out:
        register = Registration(reader.calibration)
        views = []
        for sensor in reader.frames(held_out):
            views.append(score_view(content, register(sensor)))
            progress(len(views), len(held_out))
        scores |= view_summary(views)
    if mesh_bytes is not None:
        mesh = extract_mesh(content, voxel_m)
        scores |= mesh_scores(mesh.vertices_m, read_ply_vertices(mesh_bytes))
    scores["map_mb"] = sum(content.sizes_bytes().values()) / 1e6
    return scores
