"""The averaged field, the map: a running mean of the field, kept, restored and used."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from proground_log.field.config import FieldConfig
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.mapping.map_file import load_map
from proground_log.mapping.neural.config import BufferConfig, NeuralConfig, SamplingConfig
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.perception.of_log import perception_of
from proground_log.run.settings import ReplayConfig, SimulationConfig, TelemetryConfig
from replay.session import replay
from tests.mapping.neural.wall import BOUNDS, wall_frame
from tests.regions import write_perceived_log

pytestmark = pytest.mark.slow

SMALL = NeuralConfig(
    field=FieldConfig(log2_rows=8, levels=4, voxel_m=0.1),
    sampling=SamplingConfig(rays=32, uniform=4, near_surface=3),
    buffer=BufferConfig(capacity=500, keyframe_samples=60),
)


def parameters(field: torch.nn.Module) -> dict[str, np.ndarray]:
    return {n: p.detach().numpy().astype(np.float64) for n, p in field.named_parameters()}


def mean_of(moments: list[dict[str, np.ndarray]], weights: list[float]) -> dict[str, np.ndarray]:
    return {
        name: np.average([moment[name] for moment in moments], axis=0, weights=weights)
        for name in moments[0]
    }


def weights_of(count: int, share: float) -> list[float]:
    """How much each of the moments counts: at first in proportion to 1, 2, 3, ..."""
    weights: list[float] = []
    for number in range(count):
        newest = max(share, (number + 1) / sum(range(number + 2)))
        weights = [weight * (1 - newest) for weight in weights] + [newest]
    return weights


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 1.0])
def test_the_averaged_field_is_a_running_mean(share: float) -> None:
    mapper = OnlineMapper(replace(SMALL, average_share=share), BOUNDS, 0, "cpu")
    for name, array in parameters(mapper.averaged).items():
        np.testing.assert_array_equal(array, parameters(mapper.field)[name])
    moments = []
    steps = 0
    # Frames of 7 steps: the tenth steps fall anywhere in a frame.
    for index in range(12):
        mapper.insert(wall_frame(index, 0.02 * index))
        for _ in range(7):
            before = parameters(mapper.averaged)
            mapper.step()
            after = parameters(mapper.averaged)
            if steps % 10 == 0:
                moments.append(parameters(mapper.field))
                expected = mean_of(moments, weights_of(len(moments), share))
                for name, array in after.items():
                    np.testing.assert_allclose(array, expected[name], atol=1e-5)
            else:
                for name, array in after.items():
                    np.testing.assert_array_equal(array, before[name])
            steps += 1
    assert len(moments) == 9
    if share == 0.0:
        linear = mean_of(moments, list(range(1, 10)))
        for name, array in parameters(mapper.averaged).items():
            np.testing.assert_allclose(array, linear[name], atol=1e-5)
    trembling = np.abs(mapper.averaged.table.numpy() - mapper.field.table.detach().numpy()).max()
    assert trembling > 1e-3


def test_it_is_saved_and_restored_between_two_of_its_moves() -> None:
    def go_on(mapper: OnlineMapper, frames: range) -> OnlineMapper:
        for index in frames:
            mapper.insert(wall_frame(index, 0.02 * index))
            for _ in range(7):
                mapper.step()
        return mapper

    whole = go_on(OnlineMapper(SMALL, BOUNDS, 0, "cpu"), range(9))
    half = go_on(OnlineMapper(SMALL, BOUNDS, 0, "cpu"), range(4))
    resumed = OnlineMapper(SMALL, BOUNDS, 0, "cpu")
    resumed.restore({name: array.copy() for name, array in half.state().items()})
    for name, array in parameters(half.averaged).items():
        np.testing.assert_array_equal(parameters(resumed.averaged)[name], array)
    go_on(resumed, range(4, 9))
    for name, array in parameters(whole.averaged).items():
        np.testing.assert_array_equal(parameters(resumed.averaged)[name], array)


def test_it_gets_no_gradient_and_leaves_the_field_its_own() -> None:
    mapper = OnlineMapper(SMALL, BOUNDS, 0, "cpu")
    mapper.insert(wall_frame(0))
    for _ in range(3):
        mapper.step()
    assert all(p.grad is None and not p.requires_grad for p in mapper.averaged.parameters())
    assert all(p.grad is not None for p in mapper.field.parameters())
    storages = {p.data_ptr() for p in mapper.field.parameters()}
    assert storages.isdisjoint(p.data_ptr() for p in mapper.averaged.parameters())


def test_the_map_of_a_replay_is_the_averaged_field_with_its_heads(tmp_path: Path) -> None:
    log = write_perceived_log(tmp_path / "log.mcap")
    telemetry = TelemetryConfig(enabled=False)
    config = ReplayConfig(
        steps=6,
        seed=3,
        device="cpu",
        simulation=SimulationConfig(keyframe_every=1),
        mapper=SMALL,
        telemetry=telemetry,
    )
    replay(log, tmp_path / "run", config)
    saved = load_map(tmp_path / "run" / "map.safetensors")

    reader = LogReader(log)
    perception = perception_of(reader)
    mapper = OnlineMapper(SMALL, reader.recording.bounds, 3, "cpu", perception)
    register = Registration(reader.calibration)
    for sensor in reader.frames(range(len(reader))):
        mapper.insert(register(sensor))
        for _ in range(6):
            mapper.step()
    averaged, newest = dict(mapper.averaged.named_parameters()), mapper.field.table
    for name, parameter in saved.field.named_parameters():
        if name != "table":
            assert torch.equal(parameter, averaged[name])
    # The hash grid is kept in 127 steps to either side of 0, level by level.
    for start, stop in pairwise(mapper.averaged.layout.offsets):
        exact = averaged["table"][start:stop]
        error = (saved.field.table[start:stop] - exact).abs().max()
        assert error <= 0.51 * exact.abs().max() / 127
    assert not torch.allclose(saved.field.table, newest, atol=1e-2)
    assert saved.semantics is not None
    assert mapper.semantics is not None
    heads = dict(mapper.semantics.heads.named_parameters())
    for name, parameter in saved.semantics.heads.named_parameters():
        assert torch.equal(parameter, heads[name])
    assert perception is not None
    assert saved.semantics.description.to_bytes() == perception.to_bytes()
