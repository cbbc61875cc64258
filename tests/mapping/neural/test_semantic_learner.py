"""Learning meaning on a wall with a known answer: two things side by side, nothing above them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from proground_log.field.config import FieldConfig, SemanticSpace
from proground_log.field.view import EmptySpace, render_view
from proground_log.frame import Frame
from proground_log.mapping.map_file import load_map, save_map
from proground_log.mapping.neural.config import (
    BufferConfig,
    NeuralConfig,
    SamplingConfig,
    SemanticsConfig,
)
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.observed import BLOCK_M
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.mapping.neural.semantic_map import SemanticMap
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.heads import TextHeads
from proground_log.perception.task import Task, Thresholds
from proground_log.regions import Regions
from proground_log.run.settings import TelemetryConfig
from proground_log.streams import stream
from proground_log.telemetry.pictures import Pictures
from tests.mapping.neural.wall import BOUNDS, CAMERA, WALL_M, wall_frame

pytestmark = pytest.mark.slow

CONFIG = NeuralConfig(
    field=FieldConfig(log2_rows=12, levels=8, voxel_m=0.05),
    sampling=SamplingConfig(rays=256, uniform=12, near_surface=7),
    buffer=BufferConfig(capacity=2000, keyframe_samples=300),
    semantics=SemanticsConfig(capacity=1500, frame_rays=400),
)
TASK = Task("two things", ("stove", "fridge"), ("cat",), Thresholds(relevance=0.4))
LEVELS_OF_WALL = np.array([2, 0], np.uint8)
"""Left and right."""


@cache
def perception() -> PerceptionDescription:
    """Random texts; heads that differ by level, as a detector's do."""
    random = stream(0, "test perception")
    texts = random.normal(size=(3, 512))
    heads = TextHeads(
        scale=random.uniform(0.5, 2, (3, 512)).astype(np.float32),
        shift=random.normal(scale=0.2, size=(3, 512)).astype(np.float32),
        logit_scale=np.array([0.5, 1, 1.5], np.float32),
        bias=np.array([-1, 0, -2], np.float32),
    )
    unit = texts / np.linalg.norm(texts, axis=1, keepdims=True)
    return PerceptionDescription(TASK, unit.astype(np.float32), heads, {"kind": "test"})


def embedding(label: int, level: int) -> np.ndarray:
    """What the head of a level takes for a text."""
    heads, texts = perception().heads, perception().texts
    return ((4 * texts[label] - heads.shift[level]) / heads.scale[level]).astype(np.float16)


def regions_of(
    labels: list[int], levels: np.ndarray, confidence: list[float], owner: np.ndarray
) -> Regions:
    relevance = np.full((len(labels), 3), 0.05, np.float32)
    relevance[np.arange(len(labels)), labels] = confidence
    embeddings = [embedding(label, level) for label, level in zip(labels, levels, strict=True)]
    return Regions(
        boxes=np.zeros((len(labels), 4), np.float32),
        levels=levels,
        relevance=relevance,
        embeddings=np.array(embeddings, np.float16).reshape(len(labels), 512),
        owner=(owner + 1).clip(0).astype(np.uint16),
        is_box=np.zeros(len(labels), bool),
    )


def frame_with(index: int, regions: Regions, region_of: np.ndarray, shift_m: float = 0.0) -> Frame:
    region_of = region_of.astype(np.int32)
    return replace(wall_frame(index, shift_m), regions=regions, region_of=region_of)


def two_things(index: int, shift_m: float = 0.0) -> Frame:
    """Label 0 left of x = 0, label 1 right of it, nothing above y = -0.4, an edge between."""
    x_m = CAMERA.directions[..., 0] * WALL_M + shift_m
    region_of = np.where(x_m < 0, 0, 1)
    region_of[np.abs(x_m) < 0.1] = -2
    region_of[CAMERA.directions[..., 1] * WALL_M < -0.4] = -1
    regions = regions_of([0, 1], LEVELS_OF_WALL, [0.9, 0.7], region_of)
    return frame_with(index, regions, region_of, shift_m)


def four_regions(index: int = 0) -> Frame:
    """Four columns of 10 pixels: sure, just above the threshold, at it, below it; an edge above."""
    region_of = np.tile(np.arange(40) // 10, (30, 1))
    region_of[:4] = -2
    region_of[-5:] = -1
    at = float(np.float32(0.4))
    confidence = [0.9, float(np.nextafter(np.float32(0.4), np.float32(1))), at, 0.3]
    levels = np.array([0, 1, 2, 0], np.uint8)
    return frame_with(index, regions_of([0, 1, 1, 0], levels, confidence, region_of), region_of)


def new_mapper(config: NeuralConfig = CONFIG, *, with_semantics: bool = True) -> OnlineMapper:
    return OnlineMapper(config, BOUNDS, 0, "cpu", perception() if with_semantics else None)


def go_on(mapper: OnlineMapper, frames: range, steps: int = 15) -> OnlineMapper:
    for index in frames:
        mapper.insert(two_things(index, 0.1 * index))
        for _ in range(steps):
            mapper.step()
    return mapper


def semantic_state(mapper: OnlineMapper) -> dict[str, np.ndarray]:
    assert mapper.semantics is not None
    return mapper.semantics.state()


def assert_same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)
        assert array.dtype == second[name].dtype


def pixels_of(state: dict[str, np.ndarray], part: str) -> np.ndarray:
    """The pixels that rays came from, of a frame whose camera stands at the origin."""
    x, y, _ = state[f"{part}/directions"].T
    columns, rows = np.floor(x * CAMERA.fx + CAMERA.cx), np.floor(y * CAMERA.fy + CAMERA.cy)
    return np.sort((rows * CAMERA.width + columns).astype(int))


@pytest.fixture(scope="module")
def learnt() -> OnlineMapper:
    """Read it, do not go on with it."""
    return go_on(new_mapper(), range(8))


@pytest.fixture(scope="module")
def content(learnt: OnlineMapper) -> NeuralMap:
    assert learnt.semantics is not None
    semantics = SemanticMap(learnt.semantics.heads, learnt.semantics.description)
    return NeuralMap(learnt.averaged, learnt.observed, semantics)


# What is learnt.


def test_it_learns_what_is_where_and_what_is_nothing(learnt: OnlineMapper) -> None:
    assert learnt.semantics is not None
    scores = learnt.semantics.scores(7)
    assert scores is not None
    assert scores.frame_index == 7
    assert 95 < scores.label <= 100
    assert 95 < scores.uncertainty <= 100
    # Better than the third that guessing among the classes that occur would get.
    assert 60 < scores.scale <= 100
    assert 34 < scores.background <= 100
    unlearnt = new_mapper()
    unlearnt.insert(two_things(0))
    assert unlearnt.semantics is not None
    before = unlearnt.semantics.scores(0)
    assert before is not None
    assert np.isfinite([before.label, before.scale, before.background, before.uncertainty]).all()
    assert before.scale + before.background < scores.scale + scores.background - 20


def test_a_map_tells_the_two_things_at_points_that_were_never_sampled(content: NeuralMap) -> None:
    random = stream(1, "test points")
    points_m = np.stack(
        [random.uniform(-1, 1.5, 600), random.uniform(-0.9, 0.9, 600), np.full(600, WALL_M)], 1
    )
    x_m, y_m, _ = points_m.T
    points_m = points_m[(np.abs(x_m) > 0.2) & (np.abs(y_m + 0.4) > 0.1)]
    x_m, y_m, _ = points_m.T
    meaning = content.semantics_at(points_m)
    things, right = y_m > -0.4, (x_m > 0).astype(int)
    assert ((meaning.uncertainty > 0.5) != things).mean() > 0.9
    texts, heads = perception().texts, perception().heads
    for side, level in enumerate(LEVELS_OF_WALL):
        of_side = meaning.embeddings[things & (right == side)]
        assert (heads.logits(of_side, level, texts).argmax(axis=1) == side).mean() > 0.95
    expected = np.array([embedding(0, 2), embedding(1, 0)], np.float32)[right[things]]
    error = np.linalg.norm(meaning.embeddings[things] - expected, axis=1)
    assert np.median(error / np.linalg.norm(expected, axis=1)) < 0.25


def test_pictures_show_what_was_learnt_beside_what_was_seen(content: NeuralMap) -> None:
    pictures = Pictures(TelemetryConfig(view_width=40, mesh_voxel_m=0.07), BOUNDS, perception())
    frame = two_things(99, 0.25)
    view = pictures.view(content, frame)
    meaning = view.semantics
    assert meaning is not None
    assert frame.region_of is not None
    np.testing.assert_array_equal(meaning.observed_labels, np.maximum(frame.region_of, -1))
    hit = view.rendered_depth_m > 0
    sure = hit & (frame.region_of != -2)
    assert sure.mean() > 0.8
    assert content.semantics is not None
    rendered = content.render(CAMERA, frame.world_from_camera, with_meaning=True).meaning
    assert rendered is not None
    assert rendered.levels is not None
    levels, background = (a.reshape(30, 40) for a in (rendered.levels, rendered.background))
    np.testing.assert_array_equal(meaning.levels, np.where(hit, levels, 3))
    np.testing.assert_array_equal(meaning.labels == -1, (background >= 0.5) | ~hit)
    both = sure & (meaning.labels >= 0) & (meaning.observed_labels >= 0)
    assert both.sum() > 200
    assert (meaning.labels == meaning.observed_labels)[both].mean() > 0.95
    left, right = (meaning.features[both & (meaning.labels == n)].astype(int) for n in (0, 1))
    assert np.abs(left.mean(axis=0) - right.mean(axis=0)).sum() > 100
    assert (meaning.uncertainty[sure & (frame.region_of == -1)] > 0.5).mean() > 0.9

    mesh = pictures.mesh(content, 99)
    assert mesh.meaning is not None
    x_m, y_m, _ = mesh.vertices_m.T
    seen = (x_m > -1.1) & (x_m < 1.8) & (np.abs(x_m) > 0.2) & (y_m > -0.3) & (y_m < 0.9)
    assert seen.sum() > 100
    seen &= mesh.meaning.labels >= 0
    assert seen.sum() > 100
    assert (mesh.meaning.labels[seen] == (x_m[seen] > 0)).mean() > 0.95
    of_stove = mesh.meaning.relevance
    assert mesh.meaning.prompt == "stove"
    assert of_stove[seen & (x_m < 0)].mean() > 2 * of_stove[seen & (x_m > 0)].mean()


def test_a_view_without_surface_means_nothing(content: NeuralMap) -> None:
    away = np.diag([1.0, -1.0, -1.0, 1.0])
    frame = replace(two_things(0), world_from_camera=away)
    view = Pictures(TelemetryConfig(view_width=20), BOUNDS, perception()).view(content, frame)
    assert view.semantics is not None
    missed = view.rendered_depth_m == 0
    assert missed.mean() > 0.5
    assert (view.semantics.labels[missed] == -1).all()
    assert (view.semantics.levels[missed] == 3).all()
    assert (view.semantics.features[missed] == 0).all()
    assert (view.semantics.uncertainty[missed] == 1).all()


def test_semantics_do_not_change_what_a_camera_sees(content: NeuralMap) -> None:
    pose = two_things(0, 0.25).world_from_camera
    plain = replace(content, semantics=None).render(CAMERA, pose)
    view = content.render(CAMERA, pose, with_meaning=True)
    np.testing.assert_array_equal(view.color, plain.color)
    np.testing.assert_array_equal(view.depth_m, plain.depth_m)
    assert plain.meaning is None
    assert view.meaning is not None
    empty = EmptySpace(
        content.observed.distance_m(), np.array(BOUNDS.lower_m), BLOCK_M, torch.device("cpu")
    )
    space = SemanticSpace()
    _, _, features = render_view(content.field, empty, CAMERA, pose, near_m=0.05, space=space)
    assert features is not None
    # Each axis' bins add up to 1, and so do the weights along a ray that hits something.
    mass = features.blob.reshape(-1, 3, 16).sum(dim=2)
    hit = torch.from_numpy(view.depth_m.reshape(-1) > 0)
    torch.testing.assert_close(mass, hit.float()[:, None].expand(-1, 3), atol=1e-4, rtol=0)


def test_a_saved_map_means_the_same(content: NeuralMap, tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.safetensors" for name in "abc"]
    save_map(paths[0], content)
    save_map(paths[1], content)
    loaded = load_map(paths[0])
    save_map(paths[2], loaded)
    assert len({path.read_bytes() for path in paths}) == 1
    points_m = np.array([[-0.5, 0.2, 2.0], [0.7, 0.5, 2.0], [0.3, -0.8, 2.0]])
    ours, theirs = content.meaning(points_m), loaded.meaning(points_m)
    for name, array in vars(ours).items():
        np.testing.assert_allclose(vars(theirs)[name], array, atol=0.02)
    assert loaded.description is not None
    assert loaded.description.to_bytes() == perception().to_bytes()
    assert sum(content.sizes_bytes().values()) == pytest.approx(paths[0].stat().st_size, abs=3000)


# What is not touched.


def test_geometry_and_color_are_the_same_with_and_without_semantics(learnt: OnlineMapper) -> None:
    plain = go_on(new_mapper(with_semantics=False), range(8))
    off = replace(CONFIG, semantics=SemanticsConfig(enabled=False))
    state = learnt.state()
    rest = {name: a for name, a in state.items() if not name.startswith("semantics/")}
    assert len(rest) < len(state)
    assert_same(plain.state(), rest)
    turned_off = new_mapper(off)
    assert turned_off.semantics is None
    plain = go_on(new_mapper(with_semantics=False), range(2), steps=3)
    assert_same(go_on(turned_off, range(2), steps=3).state(), plain.state())


def test_no_gradient_reaches_the_field() -> None:
    mapper = new_mapper()
    mapper.insert(two_things(0))
    assert mapper.semantics is not None
    assert mapper.semantics.step(0, 0) is not None
    for field in (mapper.field, mapper.averaged):
        assert all(parameter.grad is None for parameter in field.parameters())
    heads = mapper.semantics.heads
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in heads.parameters())


@pytest.mark.parametrize("name", ["field", "averaged"])
def test_meaning_is_learnt_on_the_averaged_field_alone(name: str) -> None:
    mappers = [go_on(new_mapper(), range(2), steps=2) for _ in range(2)]
    with torch.no_grad():
        for parameter in getattr(mappers[1], name).parameters():
            parameter.mul_(1.5)
    steps = [mapper.semantics.step(1, 2) for mapper in mappers if mapper.semantics is not None]
    first, second = (step.losses for step in steps if step is not None)
    assert (first == second) == (name == "field")


def test_every_term_of_the_total_counts() -> None:
    weights = replace(CONFIG.weights, semantic=0.3, scale=7.0, uncertainty=2.0)
    mapper = new_mapper(replace(CONFIG, weights=weights))
    mapper.insert(two_things(0))
    result = mapper.step()
    assert result is not None
    losses = dict(result.losses)
    total = losses.pop("total")
    assert {"semantic", "scale", "uncertainty", "rgb", "sdf"} < set(losses)
    expected = sum(getattr(weights, name) * value for name, value in losses.items())
    assert total == pytest.approx(expected, rel=1e-5)


# What is learnt from.


@pytest.mark.parametrize("filter_regions", [True, False])
def test_only_regions_above_the_threshold_teach_and_what_is_none_is_background(
    filter_regions: bool,
) -> None:
    semantics = replace(CONFIG.semantics, filter_regions=filter_regions, frame_rays=10_000)
    mapper = new_mapper(replace(CONFIG, semantics=semantics))
    frame = four_regions()
    mapper.insert(frame)
    assert frame.region_of is not None
    owner = frame.region_of.reshape(-1)
    teach = (owner >= 0) & (owner < (2 if filter_regions else 4))
    state = semantic_state(mapper)
    np.testing.assert_array_equal(pixels_of(state, "buffer"), np.flatnonzero(teach))
    background = owner == -1
    np.testing.assert_array_equal(pixels_of(state, "background"), np.flatnonzero(background))
    assert mapper.semantics is not None
    assert mapper.semantics.statistics().inserted == teach.sum() + background.sum()
    # Each ray with its own region.
    of = state["buffer/regions"]
    columns = np.floor(state["buffer/directions"][:, 0] * CAMERA.fx + CAMERA.cx).astype(int) // 10
    assert frame.regions is not None
    np.testing.assert_array_equal(
        state["buffer/table/embeddings"][of], frame.regions.embeddings[columns]
    )
    np.testing.assert_array_equal(
        state["buffer/table/confidence"][of], frame.regions.confidence[columns]
    )
    np.testing.assert_array_equal(state["buffer/table/levels"][of], frame.regions.levels[columns])
    np.testing.assert_array_equal(state["buffer/table/labels"][of], frame.regions.labels[columns])


@pytest.mark.parametrize("filter_regions", [True, False])
def test_what_does_not_teach_changes_nothing(filter_regions: bool) -> None:
    semantics = replace(CONFIG.semantics, filter_regions=filter_regions)

    def state_after(change_embeddings: bool, edge_depth_m: float) -> dict[str, np.ndarray]:
        mapper = new_mapper(replace(CONFIG, semantics=semantics))
        mapper.insert(two_things(0))
        frame = four_regions(1)
        assert frame.regions is not None
        embeddings, depth_m = frame.regions.embeddings.copy(), frame.depth_m.copy()
        if change_embeddings:
            embeddings[2:] = 9
        depth_m[:4] = edge_depth_m
        regions = replace(frame.regions, embeddings=embeddings)
        mapper.insert(replace(frame, regions=regions, depth_m=depth_m))
        assert mapper.semantics is not None
        for iteration in range(3):
            mapper.semantics.step(1, iteration)
        return mapper.semantics.state()

    plain = state_after(False, WALL_M)
    assert_same(plain, state_after(False, 1.2))
    changed = state_after(True, WALL_M)
    same = np.array_equal(plain["field/semantic"], changed["field/semantic"])
    assert same == filter_regions


def test_regions_have_their_share_of_a_frame_by_the_root_of_their_area() -> None:
    region_of = np.zeros((30, 40), int)
    region_of[:, 20:] = 1
    region_of[3:6, 3:8] = 2
    regions = regions_of([0, 1, 2], np.array([0, 1, 2], np.uint8), [0.9, 0.8, 0.7], region_of)
    mapper = new_mapper(replace(CONFIG, semantics=replace(CONFIG.semantics, frame_rays=50)))
    for index in range(24):
        mapper.insert(frame_with(index, regions, region_of))
    assert mapper.semantics is not None
    statistics = mapper.semantics.statistics()
    assert statistics.samples == 24 * 50
    assert statistics.background == 0
    # Of 585, 600 and 15 pixels; a share by area would be 15, one in equal parts 360.
    assert statistics.labels["cat"] == pytest.approx(24 * 50 * 15**0.5 / 52.5, abs=30)
    assert statistics.labels["stove"] == pytest.approx(statistics.labels["fridge"], abs=60)


def test_relevance_is_a_weight_or_is_not() -> None:
    def losses(weight_regions: bool, confidence: list[float]) -> dict[str, float]:
        semantics = replace(CONFIG.semantics, weight_regions=weight_regions)
        mapper = new_mapper(replace(CONFIG, semantics=semantics))
        frame = two_things(0)
        assert frame.region_of is not None
        regions = regions_of([0, 1], LEVELS_OF_WALL, confidence, frame.region_of)
        mapper.insert(replace(frame, regions=regions))
        assert mapper.semantics is not None
        step = mapper.semantics.step(0, 0)
        assert step is not None
        return step.losses

    unweighted = losses(False, [0.9, 0.5])
    assert unweighted == losses(True, [1.0, 1.0])
    weighted = losses(True, [0.9, 0.5])
    assert weighted["semantic"] != pytest.approx(unweighted["semantic"], rel=1e-3)
    assert weighted["scale"] == unweighted["scale"]


def test_a_frame_without_regions_teaches_nothing_and_one_with_none_that_all_is_background() -> None:
    mapper = new_mapper()
    mapper.insert(wall_frame(0))
    result = mapper.step()
    assert result is not None
    assert "semantic" not in result.losses
    assert mapper.semantics is not None
    assert mapper.semantics.scores(0) is None
    assert mapper.semantics.statistics().background == 0

    region_of = np.full((30, 40), -1)
    region_of[10:12] = -2
    nothing = regions_of([], np.zeros(0, np.uint8), [], region_of)
    mapper = new_mapper(replace(CONFIG, semantics=replace(CONFIG.semantics, frame_rays=9999)))
    mapper.insert(frame_with(0, nothing, region_of))
    result = mapper.step()
    assert result is not None
    assert "semantic" not in result.losses
    assert np.isfinite(result.losses["scale"])
    assert np.isfinite(result.losses["uncertainty"])
    assert mapper.semantics is not None
    statistics = mapper.semantics.statistics()
    assert (statistics.samples, statistics.background) == (0, 28 * 40)
    scores = mapper.semantics.scores(0)
    assert scores is not None
    assert np.isnan(scores.label)
    assert np.isnan(scores.scale)
    assert 0 <= scores.background <= 100


def test_a_frame_full_of_regions_has_no_background() -> None:
    region_of = np.zeros((30, 40), int)
    regions = regions_of([1], np.array([1], np.uint8), [0.9], region_of)
    mapper = new_mapper()
    mapper.insert(frame_with(0, regions, region_of))
    result = mapper.step()
    assert result is not None
    assert np.isfinite([result.losses[name] for name in ("semantic", "scale", "uncertainty")]).all()
    assert mapper.semantics is not None
    scores = mapper.semantics.scores(0)
    assert scores is not None
    assert np.isnan(scores.background)
    assert np.isfinite([scores.label, scores.scale, scores.uncertainty]).all()


# What is held.


def test_statistics_count_what_is_held(learnt: OnlineMapper) -> None:
    assert learnt.semantics is not None
    statistics, state = learnt.semantics.statistics(), learnt.semantics.state()
    of = state["buffer/regions"]
    labels, levels = state["buffer/table/labels"][of], state["buffer/table/levels"][of]
    assert statistics.samples == len(of) > 0
    assert statistics.capacity == 1500
    assert statistics.background == len(state["background/ranks"]) > 0
    # Two regions on each of eight frames.
    assert statistics.regions == len(state["buffer/table/labels"]) == 16
    counts = {prompt: int((labels == n).sum()) for n, prompt in enumerate(TASK.all_prompts)}
    assert statistics.labels == counts
    assert list(statistics.labels) == ["stove", "fridge", "cat"]
    assert counts["cat"] == 0 < counts["stove"]
    assert statistics.levels == [int((levels == level).sum()) for level in range(3)]
    held = [a for name, a in state.items() if name.startswith(("buffer/", "background/"))]
    assert statistics.size_bytes == sum(array.nbytes for array in held)


def test_what_comes_in_less_what_goes_is_held() -> None:
    semantics = replace(CONFIG.semantics, capacity=700)
    mapper = new_mapper(replace(CONFIG, semantics=semantics))
    assert mapper.semantics is not None
    inserted = evicted = 0
    for index in range(10):
        mapper.insert(two_things(index, 0.05 * index))
        statistics = mapper.semantics.statistics()
        held = statistics.samples + statistics.background
        assert statistics.inserted - statistics.evicted == held
        assert max(statistics.samples, statistics.background) <= 700
        assert statistics.inserted > inserted
        assert statistics.evicted >= evicted
        inserted, evicted = statistics.inserted, statistics.evicted
    assert evicted > 0


# Determinism.


def test_a_restored_mapper_goes_on_as_if_nothing_had_happened() -> None:
    whole = go_on(new_mapper(), range(5), steps=4)
    half = go_on(new_mapper(), range(3), steps=4)
    resumed = new_mapper()
    resumed.restore({name: array.copy() for name, array in half.state().items()})
    assert_same(resumed.state(), half.state())
    go_on(resumed, range(3, 5), steps=4)
    assert_same(whole.state(), resumed.state())
    assert whole.semantics is not None
    assert resumed.semantics is not None
    assert whole.semantics.scores(4) == resumed.semantics.scores(4)
    assert whole.semantics.statistics() == resumed.semantics.statistics()


def test_scores_leave_no_trace() -> None:
    mapper, watched = new_mapper(), new_mapper()
    for index in range(3):
        for each in (mapper, watched):
            go_on(each, range(index, index + 1), steps=3)
        assert watched.semantics is not None
        assert watched.semantics.scores(index) == watched.semantics.scores(index)
    assert_same(mapper.state(), watched.state())


def test_the_heads_do_not_depend_on_the_number_of_threads() -> None:
    before = torch.get_num_threads()
    states = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            states.append(go_on(new_mapper(), range(2), steps=3).state())
    finally:
        torch.set_num_threads(before)
    assert_same(*states)
