"""What asking costs: loading a map, its surface, and a query, taken apart into what dominates."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, median_seconds
from benchmarks.semantics import mapper_in_the_room
from benchmarks.step import BOUNDS
from proground_log.mapping.map_file import load_map, save_map
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.semantic_map import SemanticMap
from proground_log.perception.texts import of_length_1
from proground_log.query.grounding import relevance_to
from proground_log.query.mesh import extract_mesh
from proground_log.streams import stream
from replay.device import choose_device

VERTICES, PROMPTS = 100_000, 100
MESH_VOXEL_M = 0.02


def measure() -> list[Row]:
    """A query of 100,000 vertices by 100 prompts, and what has to be there before it."""
    choose_device("cpu")
    mapper = mapper_in_the_room(with_semantics=True)
    learner = mapper.semantics
    assert learner is not None
    semantics = SemanticMap(learner.heads, learner.description)
    content = NeuralMap(mapper.averaged, mapper.observed, semantics)
    draw = stream(0, "benchmark of queries")
    points_m = draw.uniform(BOUNDS.lower_m, BOUNDS.upper_m, (VERTICES, 3)).astype(np.float32)
    texts = of_length_1(draw.standard_normal((PROMPTS, 512)), "benchmark")
    logits, background = content.ask(points_m, texts)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "map.safetensors")
        save_map(path, content)
        ask_s, field_s, decide_s, load_s, mesh_s = median_seconds(
            lambda: content.ask(points_m, texts),
            lambda: list(content.features_at(points_m)),
            lambda: relevance_to(logits[:, 0], logits.max(axis=1), background),
            lambda: load_map(path),
            lambda: extract_mesh(content, MESH_VOXEL_M),
            rounds=3,
        )
    query_s = ask_s + decide_s
    return [
        Row("load a map", 1e3 * load_s, "ms", most=1000),
        Row("query of 100,000 vertices by 100 prompts", 1e3 * query_s, "ms", most=300),
        Row("of which: asking the field", 1e3 * field_s, "ms"),
        Row("of which: its heads, and the texts", 1e3 * (ask_s - field_s), "ms"),
        Row("of which: margin and relevance", 1e3 * decide_s, "ms"),
        Row("a 2 cm mesh of the built-in room, few frames", mesh_s, "s"),
    ]
