"""The neural mapper as a kind: what a replay needs to know of it."""

from __future__ import annotations

from proground_log.bounds import Bounds
from proground_log.mapping.kinds import FrameWork, MapperKind
from proground_log.mapping.neural.bench import neural_works
from proground_log.mapping.neural.config import NeuralConfig
from proground_log.mapping.neural.neural_map import load_neural_map
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.perception.description import PerceptionDescription


def _make(
    settings: NeuralConfig,
    *,
    bounds: Bounds,
    seed: int,
    device: str,
    perception: PerceptionDescription | None,
) -> OnlineMapper:
    return OnlineMapper(settings, bounds, seed, device, perception)


def _work(settings: NeuralConfig, depth_pixels: int, *, learns: bool) -> FrameWork:
    sampling, semantics = settings.sampling, settings.semantics
    samples = sampling.rays * (sampling.uniform + sampling.near_surface)
    if not learns:
        return FrameWork(insert={"insert": depth_pixels}, step={"step": samples})
    of_meaning = (semantics.rays + semantics.background_rays) * semantics.samples
    return FrameWork(
        insert={"insert": depth_pixels},
        regions={"semantic_insert": depth_pixels},
        step={"step": samples, "semantic_step": of_meaning},
    )


def _learns(settings: NeuralConfig) -> bool:
    return settings.semantics.enabled


KIND = MapperKind(
    settings=NeuralConfig,
    make=_make,
    load=load_neural_map,
    work=_work,
    learns=_learns,
    works=neural_works,
)
