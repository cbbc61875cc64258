"""The online mapper on a scene with a known answer: a wall, two metres ahead, in two colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from proground_log.camera import Camera
from proground_log.field.config import FieldConfig
from proground_log.mapping.map_file import load_map, save_map
from proground_log.mapping.neural.config import BufferConfig, NeuralConfig, SamplingConfig
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.query.mesh import extract_mesh
from tests.mapping.neural.wall import BOUNDS, CAMERA, WALL_M, wall_frame

pytestmark = pytest.mark.slow

CONFIG = NeuralConfig(
    field=FieldConfig(log2_rows=12, levels=8, voxel_m=0.05),
    sampling=SamplingConfig(rays=256, uniform=12, near_surface=7),
    buffer=BufferConfig(capacity=2000, keyframe_samples=300),
)


def mapped(config: NeuralConfig = CONFIG, *, seed: int = 0, frames: int = 6) -> OnlineMapper:
    mapper = OnlineMapper(config, BOUNDS, seed, "cpu")
    for index in range(frames):
        mapper.insert(wall_frame(index, 0.1 * index))
        for _ in range(15):
            mapper.step()
    return mapper


@pytest.fixture(scope="module")
def wall() -> OnlineMapper:
    return mapped()


def test_it_learns_the_wall(wall: OnlineMapper) -> None:
    content = NeuralMap(wall.averaged, wall.observed)
    frame = wall_frame(0, 0.25)
    view = content.render(CAMERA, frame.world_from_camera)
    color, depth_m = view.color, view.depth_m
    assert np.abs(depth_m - WALL_M).mean() < 0.02
    away_from_the_border = np.abs(CAMERA.directions[..., 0] * WALL_M + 0.25) > 0.15
    error = np.abs(color.astype(int) - frame.color)[away_from_the_border]
    assert error.mean() < 12


def test_sdf_is_the_signed_distance_in_truncations(wall: OnlineMapper) -> None:
    z_m = torch.tensor([1.0, 1.5, 1.95, 2.0, 2.05])
    points_m = torch.stack([torch.full((5,), 0.3), torch.full((5,), 0.2), z_m], dim=1)
    with torch.no_grad():
        sdf = wall.field.sdf(wall.field.normalise(points_m)[0])
    np.testing.assert_allclose(sdf, [1.0, 1.0, 0.5, 0.0, -0.5], atol=0.2)


def test_the_mesh_is_the_wall_and_only_where_it_was_seen(wall: OnlineMapper) -> None:
    mesh = extract_mesh(NeuralMap(wall.averaged, wall.observed), 0.05)
    assert len(mesh.vertices_m) > 500
    assert np.abs(mesh.vertices_m[:, 2] - WALL_M).mean() < 0.02
    seen_to_m = np.abs(CAMERA.directions[..., 0]).max() * WALL_M + 0.5
    assert np.abs(mesh.vertices_m[:, 0]).max() < seen_to_m + 0.15
    # Free space is on the camera's side, at smaller z; so are normals, and faces look there.
    well_seen = (np.abs(mesh.vertices_m[:, :2]) < (1.0, 0.7)).all(axis=1)
    assert (mesh.normals[well_seen, 2] < -0.5).mean() > 0.95
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    facing = np.cross(b - a, c - a)[:, 2] < 0
    assert facing[well_seen[mesh.faces].all(axis=1)].mean() > 0.95
    left, right = mesh.vertices_m[:, 0] < -0.3, mesh.vertices_m[:, 0] > 0.3
    assert (mesh.colors[left, 0] > 120).mean() > 0.9
    assert (mesh.colors[right, 1] > 120).mean() > 0.9


def test_the_same_seed_gives_the_same_map_and_another_seed_another() -> None:
    first, second, third = mapped(frames=2), mapped(frames=2), mapped(frames=2, seed=1)
    state, same, other = first.state(), second.state(), third.state()
    for name, array in state.items():
        np.testing.assert_array_equal(array, same[name], err_msg=name)
    assert not np.array_equal(state["field/table"], other["field/table"])


def test_a_restored_mapper_goes_on_as_if_nothing_had_happened() -> None:
    whole = mapped(frames=4)
    half = mapped(frames=2)
    state = {name: array.copy() for name, array in half.state().items()}
    resumed = OnlineMapper(CONFIG, BOUNDS, 0, "cpu")
    resumed.restore(state)
    for index in (2, 3):
        resumed.insert(wall_frame(index, 0.1 * index))
        for _ in range(15):
            resumed.step()
    expected, found = whole.state(), resumed.state()
    assert expected.keys() == found.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(array, found[name], err_msg=name)


def test_beta_weighs_replayed_rays_against_current_ones() -> None:
    """With beta = 0 the replayed rays must not matter (Eq. 2), whatever they show."""

    def first_step_after_a_lie(beta: float, lie: bool) -> dict[str, float]:
        mapper = OnlineMapper(replace(CONFIG, beta=beta), BOUNDS, 0, "cpu")
        frame = wall_frame(0)
        if lie:
            frame = replace(frame, color=255 - frame.color)
        mapper.insert(frame)
        mapper.insert(wall_frame(1))
        rays, current, _ = mapper._draw_rays()
        assert (current, len(rays)) == (64, 256)
        (result,) = mapper.steps(1)
        return result.losses

    assert first_step_after_a_lie(0.0, True) == first_step_after_a_lie(0.0, False)
    assert first_step_after_a_lie(1.0, True)["rgb"] != first_step_after_a_lie(1.0, False)["rgb"]


def test_keyframes_alone_are_remembered_and_the_buffer_stays_bounded() -> None:
    mapper = OnlineMapper(CONFIG, BOUNDS, 0, "cpu")
    for i in range(30):
        frame, held = wall_frame(i, 0.02 * i), len(mapper.buffer)
        inserted = mapper.insert(frame, is_keyframe=i % 3 == 0)
        assert len(inserted) == (i % 3 == 0)
        if not inserted:
            assert len(mapper.buffer) == held
    assert len(mapper.buffer) <= 2000


def test_a_frame_without_depth_is_survived() -> None:
    mapper = OnlineMapper(CONFIG, BOUNDS, 0, "cpu")
    blind = replace(wall_frame(0), depth_m=np.zeros((30, 40), np.float32))
    assert mapper.insert(blind) == ()
    assert mapper.steps(3) == []
    mapper.insert(wall_frame(1))
    mapper.insert(wall_frame(2))
    mapper.insert(blind)
    _, current, _ = mapper._draw_rays()
    assert current == 0
    assert len(mapper.steps(3)) == 3


def test_every_term_of_the_total_counts(wall: OnlineMapper) -> None:
    result = wall.step()
    assert result is not None
    weights = CONFIG.weights
    expected = sum(
        getattr(weights, name) * value for name, value in result.losses.items() if name != "total"
    )
    assert result.losses["total"] == pytest.approx(expected, rel=1e-5)
    assert set(result.losses) == {"rgb", "depth", "sdf", "free_space", "smoothness", "total"}


def test_a_saved_map_is_the_map(wall: OnlineMapper, tmp_path) -> None:  # type: ignore[no-untyped-def]
    content = NeuralMap(wall.averaged, wall.observed)
    save_map(tmp_path / "a.safetensors", content)
    save_map(tmp_path / "b.safetensors", content)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    loaded = load_map(tmp_path / "a.safetensors")
    pose = wall_frame(0).world_from_camera
    ours, theirs = content.render(CAMERA, pose), loaded.render(CAMERA, pose)
    # The hash grid is kept in 255 steps a level.
    assert np.abs(ours.color.astype(int) - theirs.color).mean() < 1
    np.testing.assert_allclose(ours.depth_m, theirs.depth_m, atol=0.01)
    save_map(tmp_path / "c.safetensors", loaded)
    assert (tmp_path / "c.safetensors").read_bytes() == (tmp_path / "a.safetensors").read_bytes()
    parts = content.sizes_bytes()
    assert (tmp_path / "a.safetensors").stat().st_size == pytest.approx(
        sum(parts.values()), abs=3000
    )


def test_antialiasing_touches_edges_alone(wall: OnlineMapper) -> None:
    content, pose = NeuralMap(wall.averaged, wall.observed), wall_frame(0).world_from_camera
    plain = content.render(CAMERA, pose)
    smooth = content.render(CAMERA, pose, antialias=True)
    np.testing.assert_array_equal(smooth.depth_m, plain.depth_m)
    changed = (smooth.color != plain.color).any(axis=2)
    # Red meets green at x = 0, between columns 19 and 20; away from it all is as it was.
    assert changed[:, 17:23].any()
    flat = np.abs(np.arange(40) - 19.5) > 8
    assert changed[:, flat].mean() < 0.2
    large = Camera(80, 60, 60.0, 60.0, 40.0, 30.0)
    four = content.render(large, pose).color.reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))
    assert np.abs(smooth.color[changed] - four[changed]).max() <= 1.5


@pytest.mark.parametrize("voxel_m", [0.03, 0.05, 0.1, 0.12, 0.15])
def test_a_mesh_of_any_voxel_has_the_wall(wall: OnlineMapper, voxel_m: float) -> None:
    """Coarse voxels, as telemetry takes in a large scene, ask far around what was seen."""
    mesh = extract_mesh(NeuralMap(wall.averaged, wall.observed), voxel_m)
    shape = np.ptp(mesh.vertices_m[np.abs(mesh.vertices_m[:, 2] - WALL_M) < 0.05], axis=0)
    assert shape[0] > 2.0
    assert shape[1] > 1.2
