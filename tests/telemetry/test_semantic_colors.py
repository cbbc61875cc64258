"""Colours of meaning: a projection that is fixed by the task, and shows differences, not noise."""

from __future__ import annotations

import numpy as np
import pytest

from proground_log.mapping.neural.grounding import aligned
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.heads import TextHeads
from proground_log.perception.task import Task
from proground_log.streams import stream
from proground_log.telemetry.semantic_colors import CONTRAST, SemanticColors


def perception(count: int, order: list[int] | None = None) -> PerceptionDescription:
    """Random texts, and heads that differ by level."""
    random = stream(0, "test texts", count)
    texts = random.normal(size=(count, 512)).astype(np.float32)
    texts /= np.linalg.norm(texts, axis=1, keepdims=True)
    order = order or list(range(count))
    heads = TextHeads(
        scale=random.uniform(0.5, 2, (3, 512)).astype(np.float32),
        shift=random.normal(scale=0.1, size=(3, 512)).astype(np.float32),
        logit_scale=np.zeros(3, np.float32),
        bias=np.zeros(3, np.float32),
    )
    prompts = tuple(f"thing {number}" for number in order)
    return PerceptionDescription(Task("things", prompts), texts[order], heads, {})


def colors_of(description: PerceptionDescription, wanted: np.ndarray, level: int = 0) -> np.ndarray:
    """Colours of what a map holds whose heads bring it to `wanted`, the level being sure."""
    heads = description.heads
    embeddings = ((wanted - heads.shift[level]) / heads.scale[level]).astype(np.float32)
    scale_logits = np.full((len(wanted), 4), -30, np.float32)
    scale_logits[:, level] = 30
    return SemanticColors(description)(aligned(embeddings, scale_logits, heads)).astype(int)


def test_colors_are_the_principal_components_of_the_texts() -> None:
    description = perception(8)
    texts = description.texts.astype(np.float64)
    between = texts[:4] + 0.7 * texts[3:7]
    found = colors_of(description, between)

    centred = texts - texts.mean(axis=0)
    variances, directions = np.linalg.eigh(centred.T @ centred / len(texts))
    unit = between / np.linalg.norm(between, axis=1, keepdims=True)
    for channel in range(3):
        direction = directions[:, -1 - channel]
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        place = (unit - texts.mean(axis=0)) @ direction / np.sqrt(variances[-1 - channel])
        expected = 127.5 + 127.5 * np.clip(place / CONTRAST, -1, 1)
        np.testing.assert_allclose(found[:, channel], expected, atol=1)
    assert found.std(axis=0).min() > 10


@pytest.mark.parametrize("count", [2, 3, 8, 40])
def test_a_color_tells_the_text_but_neither_level_nor_length(count: int) -> None:
    description = perception(count)
    found = colors_of(description, description.texts)
    for level in (1, 2):
        np.testing.assert_allclose(colors_of(description, description.texts, level), found, atol=1)
    np.testing.assert_allclose(colors_of(description, 7 * description.texts), found, atol=1)
    if count <= 8:
        apart = np.abs(found[:, None] - found[None]).sum(axis=2)
        assert apart[~np.eye(count, dtype=bool)].min() > 40


def test_between_levels_the_heads_are_mixed() -> None:
    description = perception(5)
    heads = description.heads
    scale, shift = (0.25 * each[0] + 0.75 * each[2] for each in (heads.scale, heads.shift))
    logits = np.tile(np.log([0.25, 1e-12, 0.75, 50]).astype(np.float32), (5, 1))
    embeddings = ((description.texts - shift) / scale).astype(np.float32)
    found = SemanticColors(description)(aligned(embeddings, logits, heads))
    np.testing.assert_allclose(found.astype(int), colors_of(description, description.texts), atol=1)


def test_the_basis_depends_on_the_texts_and_not_on_their_order() -> None:
    straight, mixed = perception(7), perception(7, [3, 1, 6, 0, 5, 2, 4])
    points = (
        stream(1, "test points").normal(size=(50, 512)) + 20 * straight.texts[np.arange(50) % 7]
    )
    first, second = colors_of(straight, points), colors_of(mixed, points)
    np.testing.assert_allclose(first, second, atol=1)
    np.testing.assert_array_equal(first, colors_of(perception(7), points))


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_noise_hardly_shows_however_few_texts_there_are(count: int) -> None:
    """Fewer than four texts span fewer than three directions; the others must not blink."""
    description = perception(count)
    of = np.arange(200) % count
    noise = stream(2, "test noise").normal(scale=0.01, size=(200, 512))
    found = colors_of(description, description.texts[of] + noise)
    assert found.shape == (200, 3)
    for number in range(count):
        assert found[of == number].std(axis=0).max() < 12


def test_a_point_that_means_nothing_has_a_color() -> None:
    description = perception(3)
    nothing = colors_of(description, np.zeros((2, 512)))
    assert (nothing[0] == nothing[1]).all()
    empty = np.zeros((0, 512), np.float32)
    assert SemanticColors(description)(empty).shape == (0, 3)
    assert SemanticColors(description)(empty).dtype == np.uint8
