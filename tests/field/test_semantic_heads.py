"""What the semantic heads look at, and that they may look once a ray instead of once a sample."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn.functional import linear

from proground_log.bounds import Bounds
from proground_log.errors import ProgroundError
from proground_log.field.config import FeatureSource, FieldConfig, SemanticSpace
from proground_log.field.encodings import one_blob
from proground_log.field.neural_field import NeuralField
from proground_log.field.rendering import sdf_weights
from proground_log.field.semantic_heads import PointFeatures, SemanticHeads
from proground_log.streams import stream

BOUNDS = Bounds((-2.0, -1.0, 0.0), (2.0, 2.0, 2.5))
HASHED = 16
TABLE_4: list[tuple[FeatureSource, bool, int]] = [
    ("color", False, 32),
    ("geometry", False, 15),
    ("parametric", False, HASHED),
    ("color", True, 32 + 48),
    ("geometry", True, 15 + 48),
    ("parametric", True, HASHED + 48),
    ("none", True, 48),
]


@pytest.fixture(scope="module")
def field() -> NeuralField:
    """A field whose hash features are as large as those of one that has learnt."""
    field = NeuralField(FieldConfig(log2_rows=10, levels=8, voxel_m=0.1), BOUNDS, seed=0)
    values = stream(0, "test table").normal(scale=0.3, size=tuple(field.table.shape))
    with torch.no_grad():
        field.table.copy_(torch.from_numpy(values.astype(np.float32)))
    return field


def points(count: int) -> torch.Tensor:
    return torch.from_numpy(stream(0, "test points").random((count, 3), dtype=np.float32))


def some_heads(space: SemanticSpace) -> SemanticHeads:
    """Heads whose biases are not zero, as after training."""
    heads = SemanticHeads(space, HASHED, seed=1)
    random = stream(2, "test biases")
    with torch.no_grad():
        for bias in (heads.semantic_bias, heads.scale_bias, heads.uncertainty_bias):
            bias.copy_(torch.from_numpy(random.normal(size=len(bias)).astype(np.float32)))
    return heads


@pytest.mark.parametrize(("source", "coordinates", "width"), TABLE_4)
def test_every_space_of_table_4_has_its_features(
    field: NeuralField, source: FeatureSource, coordinates: bool, width: int
) -> None:
    space = SemanticSpace(source, coordinates)
    x = points(50)
    sdf, color, features = field.with_features(x, space)

    hashed, blob = field.hash_features(x), one_blob(x)
    geometry = field.decoders.geometry(hashed, blob)
    expected_color, color_features = field.decoders.color(geometry, blob)
    of_source = {"color": color_features, "geometry": geometry[:, 1:], "parametric": hashed}
    parts = [of_source[source]] if source != "none" else []
    parts += [blob] if coordinates else []
    torch.testing.assert_close(features.space, torch.cat(parts, dim=1), rtol=0, atol=0)
    torch.testing.assert_close(features.hashed, hashed, rtol=0, atol=0)
    torch.testing.assert_close(features.blob, blob, rtol=0, atol=0)
    torch.testing.assert_close(sdf, geometry[:, 0], rtol=0, atol=0)
    torch.testing.assert_close(color, expected_color, rtol=0, atol=0)

    assert features.space.shape == (50, width)
    heads = some_heads(space)
    assert heads.semantic.shape == (512, width)
    assert heads.embeddings(features).shape == (50, 512)


def test_a_space_of_nothing_is_refused() -> None:
    with pytest.raises(ProgroundError, match="decoded from nothing"):
        SemanticSpace("none", coordinates=False)


def test_heads_are_linear_layers_over_their_own_features(field: NeuralField) -> None:
    space = SemanticSpace()
    heads = some_heads(space)
    _, _, features = field.with_features(points(50), space)
    pairs = [
        (heads.embeddings(features), linear(features.space, heads.semantic, heads.semantic_bias)),
        (heads.scale_logits(features), linear(features.hashed, heads.scale, heads.scale_bias)),
        (
            heads.uncertainty_logits(features),
            linear(features.blob, heads.uncertainty, heads.uncertainty_bias).squeeze(1),
        ),
    ]
    for ours, expected in pairs:
        torch.testing.assert_close(ours, expected, atol=1e-6, rtol=1e-5)
        assert ours.std() > 0.01
    assert pairs[1][0].shape == (50, 4)
    assert pairs[2][0].shape == (50,)


@pytest.mark.parametrize(("source", "coordinates", "width"), TABLE_4)
def test_projecting_what_a_ray_sees_equals_rendering_what_its_samples_mean(
    field: NeuralField, source: FeatureSource, coordinates: bool, width: int
) -> None:
    rays, samples = 40, 11
    space = SemanticSpace(source, coordinates)
    heads = some_heads(space)
    _, _, features = field.with_features(points(rays * samples), space)
    sdf = stream(3, "test sdf").uniform(-0.5, 0.5, (rays, samples)).astype(np.float32)
    counts = torch.ones(rays, samples, dtype=torch.bool)
    counts[:, 8:] = False
    weights = sdf_weights(torch.from_numpy(sdf), counts)
    assert weights.max() < 0.9

    rendered = features.rendered(weights)
    assert rendered.space.shape == (rays, width)
    with torch.no_grad():
        for head in (heads.embeddings, heads.scale_logits, heads.uncertainty_logits):
            once = head(rendered)
            each = head(features).reshape(rays, samples, *once.shape[1:])
            expected = torch.einsum("rs,rs...->r...", weights, each)
            assert (once - expected).abs().max() < 2e-6


def test_only_the_heads_get_a_gradient(field: NeuralField) -> None:
    heads = some_heads(SemanticSpace())
    _, _, features = field.with_features(points(20), heads.space)
    outputs = heads.embeddings(features), heads.scale_logits(features)
    total = sum(output.sum() for output in outputs) + heads.uncertainty_logits(features).sum()
    total.backward()  # type: ignore[union-attr]
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in heads.parameters())
    assert all(p.grad is None for p in field.parameters())


def test_parts_are_concatenated_in_order(field: NeuralField) -> None:
    x = points(30)
    _, _, whole = field.with_features(x, SemanticSpace())
    parts = [field.with_features(part.clone(), SemanticSpace())[2] for part in x.split(11)]
    joined = PointFeatures.concatenate(parts)
    for name in ("space", "hashed", "blob"):
        torch.testing.assert_close(getattr(joined, name), getattr(whole, name))


def test_initial_weights_depend_on_the_seed_alone() -> None:
    first, same, other = (SemanticHeads(SemanticSpace(), HASHED, seed) for seed in (0, 0, 1))
    for name, parameter in first.named_parameters():
        assert torch.equal(parameter, dict(same.named_parameters())[name])
    for name in ("semantic", "scale", "uncertainty"):
        assert not torch.equal(getattr(first, name), getattr(other, name))
