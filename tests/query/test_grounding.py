"""Logits are those of the heads, weighed; a query claims only what nothing else fits better."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from scipy.special import expit

from proground_log.bounds import Bounds
from proground_log.field.config import FieldConfig, SemanticSpace
from proground_log.field.neural_field import NeuralField
from proground_log.field.semantic_heads import SemanticHeads
from proground_log.mapping.neural import neural_map
from proground_log.mapping.neural.grounding import background_probability, vertex_logits
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.observed import ObservedSurface
from proground_log.mapping.neural.semantic_map import SemanticMap
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.heads import TextHeads
from proground_log.perception.task import Task
from proground_log.query.grounding import relevance_to, z_scores
from proground_log.streams import stream


def heads() -> TextHeads:
    draw = stream(1, "heads")
    return TextHeads(
        scale=draw.uniform(0.5, 2, (3, 512)).astype(np.float32),
        shift=draw.normal(size=(3, 512)).astype(np.float32),
        logit_scale=np.array([-0.5, 0.2, 0.9], np.float32),
        bias=np.array([-3, 0.5, 2], np.float32),
    )


def vertices(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Embeddings and scale logits."""
    draw = stream(2, "vertices", count)
    embeddings = draw.normal(size=(count, 512)).astype(np.float32)
    return embeddings, draw.normal(scale=3, size=(count, 4)).astype(np.float32)


def unit_texts(count: int) -> np.ndarray:
    texts = stream(3, "texts", count).normal(size=(count, 512))
    return (texts / np.linalg.norm(texts, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, neural_map.BLOCK, 2 * neural_map.BLOCK + 7])
def test_logits_are_the_weighted_sum_of_what_each_head_says(count: int) -> None:
    embeddings, scale_logits = vertices(count)
    texts = unit_texts(5)
    probability = np.exp(scale_logits.astype(np.float64))[:, :3]
    probability /= probability.sum(axis=1, keepdims=True)
    expected = sum(
        probability[:, [level]] * heads().logits(embeddings, level, texts) for level in range(3)
    )
    logits = vertex_logits(embeddings, scale_logits, heads(), texts)
    assert logits.dtype == np.float32
    np.testing.assert_allclose(logits, expected, atol=1e-3)


def test_a_sure_level_is_read_by_its_own_head_whatever_the_background() -> None:
    embeddings, _ = vertices(20)
    texts = unit_texts(4)
    for level in range(3):
        scale_logits = np.full((20, 4), -50, np.float32)
        scale_logits[:, level] = 50
        scale_logits[:, 3] = np.linspace(-100, 100, 20)
        logits = vertex_logits(embeddings, scale_logits, heads(), texts)
        np.testing.assert_allclose(logits, heads().logits(embeddings, level, texts), atol=1e-3)


BOUNDS = Bounds((-1.0, 0.0, 2.0), (1.0, 3.0, 4.0))


def random_map(space: SemanticSpace) -> NeuralMap:
    """A map of which no parameter is 0, so that all of them count."""
    draw = stream(6, "map")
    field = NeuralField(FieldConfig(log2_rows=10, levels=4), BOUNDS, seed=0)
    semantic_heads = SemanticHeads(space, field.hash_width, seed=0)
    with torch.no_grad():
        for parameter in (field.table, *semantic_heads.parameters()):
            values = draw.normal(size=parameter.shape).astype(np.float32)
            parameter.add_(torch.from_numpy(values))
    description = PerceptionDescription(Task("room", ("chair",)), unit_texts(1), heads(), {})
    return NeuralMap(field, ObservedSurface(BOUNDS), SemanticMap(semantic_heads, description))


def points(count: int) -> np.ndarray:
    """Points in the map's bounds, in metres."""
    return stream(7, "points", count).uniform(BOUNDS.lower_m, BOUNDS.upper_m, (count, 3))


@pytest.mark.parametrize(
    "space",
    [
        SemanticSpace(),
        SemanticSpace("geometry", coordinates=False),
        SemanticSpace("parametric"),
        SemanticSpace("none"),
    ],
)
def test_a_map_is_asked_without_embeddings_as_its_embeddings_would_answer(
    space: SemanticSpace,
) -> None:
    content, texts = random_map(space), unit_texts(5)
    points_m = points(neural_map.BLOCK + 7)
    semantics = content.semantics_at(points_m)
    probability = np.exp(semantics.scale_logits.astype(np.float64))[:, :3]
    probability /= probability.sum(axis=1, keepdims=True)
    expected = np.sum(
        [
            probability[:, [level]] * heads().logits(semantics.embeddings, level, texts)
            for level in range(3)
        ],
        axis=0,
    )
    logits, background = content.ask(points_m, texts)
    assert logits.dtype == background.dtype == np.float32
    np.testing.assert_allclose(logits, expected, atol=1e-4)
    assert expected.std() > 1
    np.testing.assert_allclose(
        background,
        background_probability(semantics.scale_logits, semantics.uncertainty),
        atol=1e-6,
    )


def test_each_point_gets_its_own_answer_however_many_are_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    content, texts = random_map(SemanticSpace()), unit_texts(3)
    points_m = points(2 * neural_map.BLOCK + 7)
    whole = content.ask(points_m, texts)
    # Parts that are no whole blocks, the last one shorter.
    monkeypatch.setattr(neural_map, "POINTS_AT_ONCE", 900)
    monkeypatch.setattr(neural_map, "BLOCK", 400)
    for of_parts, of_whole in zip(content.ask(points_m, texts), whole, strict=True):
        np.testing.assert_allclose(of_parts, of_whole, atol=1e-5)
    logits, background = content.ask(points_m[:0], texts)
    assert logits.shape == (0, 3)
    assert background.shape == (0,)


def digests() -> list[str]:
    """Of logits from embeddings and from a map, and of the background."""
    texts = unit_texts(70)
    content = random_map(SemanticSpace())
    answers = vertex_logits(*vertices(3000), heads(), texts), *content.ask(points(3000), texts)
    return [hashlib.sha256(answer.tobytes()).hexdigest() for answer in answers]


@pytest.mark.slow
def test_answers_do_not_depend_on_the_number_of_threads() -> None:
    program = "from tests.query.test_grounding import digests; print(*digests())"
    variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    for threads in ("1", "4"):
        there = subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **dict.fromkeys(variables, threads)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        assert there.split() == digests()


def test_background_is_what_two_heads_think() -> None:
    _, scale_logits = vertices(50)
    exponentials = np.exp(scale_logits.astype(np.float64))
    expected = exponentials[:, 3] / exponentials.sum(axis=1)
    uncertainty = np.linspace(0, 1, 50)
    background = background_probability(scale_logits, uncertainty)
    np.testing.assert_allclose(background, (expected + uncertainty) / 2, rtol=1e-5)


def test_a_query_claims_what_it_fits_best_or_almost_and_no_background() -> None:
    logits = np.array(
        [
            [1.0, -4.0, -3.0],  # the query wins
            [1.0, 2.5, -3.0],  # it almost does
            [1.0, 3.5, -3.0],  # a rival fits much better
            [1.0, -4.0, -3.0],  # it wins, over background
        ],
        np.float32,
    )
    background = np.array([0.1, 0.4, 0.1, 0.9])
    best = logits.max(axis=1)
    found = relevance_to(logits[:, 0], best, background, margin=2.0)
    np.testing.assert_allclose(found, [expit(1.0), expit(1.0), 0, 0], rtol=1e-6)
    # A query that is a prompt of the task as well does not stand in its own way.
    others = logits[:, 1:].max(axis=1)
    alone = relevance_to(logits[:, 0], others, background, margin=2.0)
    np.testing.assert_array_equal(alone, found)


def test_with_no_margin_each_vertex_goes_to_its_best_text() -> None:
    draw = stream(4, "logits")
    logits = draw.normal(size=(200, 6)).astype(np.float32)
    best, seen = logits.max(axis=1), np.zeros(200)
    claims = np.stack([relevance_to(column, best, seen, margin=0.0) for column in logits.T])
    np.testing.assert_array_equal(claims.argmax(axis=0), logits.argmax(axis=1))
    assert ((claims > 0).sum(axis=0) == 1).all()


def test_z_scores_undo_the_shift_and_stretch_of_each_vertex() -> None:
    draw = stream(5, "bank")
    bank = draw.normal(size=(60, 40))
    query = draw.normal(size=60)
    query[:10] += 20  # where the thing is
    shift, stretch = draw.normal(scale=50, size=(60, 1)), draw.uniform(0.1, 9, (60, 1))
    plain = z_scores(query, bank)
    np.testing.assert_allclose(
        z_scores((query[:, None] * stretch + shift)[:, 0], bank * stretch + shift),
        plain,
        rtol=1e-4,
    )
    assert plain[:10].min() > 10 > 5 > np.abs(plain[10:]).max()


def test_a_bank_that_tells_nothing_gives_no_score() -> None:
    np.testing.assert_array_equal(z_scores(np.array([5.0, -5.0]), np.ones((2, 3))), [0, 0])
