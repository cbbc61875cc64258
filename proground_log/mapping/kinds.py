"""The kinds of mappers: those that are built in, and those that other packages bring.

A package brings one by an entry point of the group `proground_log.mappers`, which has the kind's
name and loads a `MapperKind`; see docs/mappers.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Protocol

from proground_log.errors import ProgroundError

if TYPE_CHECKING:  # The command line looks at kinds, and has to answer at once.
    from pathlib import Path

    import numpy as np

    from proground_log.bounds import Bounds
    from proground_log.mapping.bench import Bench, Works
    from proground_log.mapping.map import Map
    from proground_log.mapping.mapper import Mapper
    from proground_log.perception.description import PerceptionDescription

GROUP = "proground_log.mappers"
NEURAL = "neural"
BUILT_IN = {NEURAL: "proground_log.mapping.neural.kind"}
"""Modules with a `KIND`, by its name; imported when it is asked for."""


@dataclass(frozen=True)
class StageCost:
    """What one stage of a replay takes on some machine.

    Args:
        fixed_ns: however little there is to do.
        per_unit_ns: for each unit, beside that.
        unit: what is counted: pixel, image, sample, region, ...
        residual_percent: how far the measurements lie off this line, median; 0 if written by hand.
    """

    fixed_ns: float
    per_unit_ns: float
    unit: str
    residual_percent: float = 0.0


@dataclass(frozen=True)
class FrameWork:
    """What a mapper has to do for a frame: how many units of which stages.

    Args:
        insert: to take a frame in.
        regions: to take its regions in, whenever they come.
        step: in each optimisation step; nothing where the kind does none.
    """

    insert: Mapping[str, int]
    regions: Mapping[str, int] = field(default_factory=dict)
    step: Mapping[str, int] = field(default_factory=dict)


class MakeMapper(Protocol):
    """Makes a mapper; `settings` is of the kind's own class."""

    def __call__(
        self,
        settings: Any,
        *,
        bounds: Bounds,
        seed: int,
        device: str,
        perception: PerceptionDescription | None,
    ) -> Mapper: ...


class LoadMap(Protocol):
    """Makes a map of what its file holds; `where` is for errors."""

    def __call__(
        self, header: Mapping[str, Any], tensors: dict[str, np.ndarray], *, where: Path, device: str
    ) -> Map: ...


def _insert_alone(settings: Any, depth_pixels: int, *, learns: bool) -> FrameWork:  # noqa: ARG001
    return FrameWork(insert={"insert": depth_pixels})


@dataclass(frozen=True)
class MapperKind:
    """A kind of mapper.

    Args:
        settings: a frozen dataclass with a default for each of its fields; flags, manifests and
            sweeps have them.
        make: makes a mapper.
        load: makes a map of its file.
        work: what it has to do for a frame of so many depth pixels; `learns` says whether meaning
            is learnt.
        learns: whether it learns meaning, where there are regions to learn it from.
        costs: what its own stages take, where a cost model does not know them.
        works: its stages at several sizes, to be measured; None: those of `work` are timed whole.
    """

    settings: type
    make: MakeMapper
    load: LoadMap
    work: Callable[..., FrameWork] = _insert_alone
    learns: Callable[[Any], bool] = lambda _: False
    costs: Mapping[str, StageCost] = field(default_factory=dict)
    works: Callable[[Bench], Works] | None = None


@cache
def mapper_kind(name: str) -> MapperKind:
    """The kind of this name.

    Raises:
        ProgroundError: there is none, or the package that brings it cannot be imported.
    """
    if name in BUILT_IN:
        return _checked(import_module(BUILT_IN[name]).KIND, name)
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        names = sorted({*BUILT_IN, *found})
        nearest = get_close_matches(name, names, n=1)
        hint = f"did you mean {nearest[0]}? " if nearest else ""
        raise ProgroundError(
            f"there is no mapper {name!r}",
            where="--mapper",
            todo=f"{hint}valid: {', '.join(names)}",
        )
    point = found[name]
    package = point.dist.name if point.dist is not None else point.value
    try:
        kind = point.load()
    except Exception as error:  # Whatever the code of somebody else raises, it is theirs to mend.
        raise ProgroundError(
            f"the mapper {name!r} cannot be imported ({type(error).__name__}: {error})",
            where=f"package {package}, {point.value}",
            todo=f"mend or uninstall {package}; the built-in mappers work without it",
        ) from error
    return _checked(kind, name)


def _checked(kind: object, name: str) -> MapperKind:
    """Return the kind; raise a ProgroundError unless it is one, with sound settings."""
    fault = None
    if not isinstance(kind, MapperKind):
        fault = f"is a {type(kind).__name__}, not a MapperKind"
    elif not (dataclasses.is_dataclass(kind.settings) and _is_frozen(kind.settings)):
        fault = "has settings that are no frozen dataclass"
    else:
        try:
            kind.settings()
        except TypeError as error:
            fault = f"has settings without a default ({error})"
    if fault is not None:
        raise ProgroundError(
            f"the mapper {name!r} {fault}", where=GROUP, todo="see docs/mappers.md"
        )
    assert isinstance(kind, MapperKind)
    return kind


def _is_frozen(settings: type) -> bool:
    return bool(settings.__dataclass_params__.frozen)  # type: ignore[attr-defined]
