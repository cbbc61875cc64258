"""Settings of a replay, and the one walk over them that files, flags and sweeps share."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar, get_type_hints

import tyro

from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.mapping.kinds import NEURAL, mapper_kind
from proground_log.mapping.neural.config import NeuralConfig
from proground_log.run.cost_model import DEFAULT_MODEL

if TYPE_CHECKING:
    from proground_log.perception.description import PerceptionDescription

Overrun = Literal["drop-oldest", "drop-newest", "wait"]
Device = Literal["auto", "cpu", "cuda"]
Value = bool | int | float | str | None
"""What a setting can be set to on the command line."""
Part = TypeVar("Part")


@dataclass(frozen=True)
class TelemetryConfig:
    """What goes into the rerun recording besides every loss; none of it touches the map."""

    enabled: bool = True
    """Write telemetry.rrd."""
    view_every: int = 15
    """Every so many mapped frames, the frame's view is rendered."""
    view_width: int = 160
    """Width of the rendered views in pixels."""
    mesh_every: int = 30
    """Every so many mapped frames, the mesh is extracted."""
    mesh_voxel_m: float = 0.05
    """Its voxels; larger ones in a house, so that a mesh stays cheap."""


@dataclass(frozen=True)
class SimulationConfig:
    """The computer that the map is made on, as far as time goes; see docs/budgets.md."""

    budget_ms: float | None = None
    """Simulated time that a mapped frame may take, steps and all; without it, each gets --steps."""
    rate: float | None = None
    """Speed at which frames arrive, 1 as recorded; 0: lock-step, the next frame arrives when the
    mapper is free. By default 1 with a budget and 0 without."""
    queue: int = 1
    """Frames that may wait while the mapper is busy."""
    overrun: Overrun = "drop-oldest"
    """What gives when one more arrives; wait: it waits outside, and none is lost."""
    keyframe_every: int = 2
    """Every so many mapped frames, one becomes a keyframe."""
    perceive_every: int = 1
    """Every so many mapped frames, one is perceived."""
    perceive_keyframes_only: bool = False
    """Perceive keyframes alone."""
    perceive_beside: bool = False
    """Perception has a computer of its own: it costs the mapper nothing, and comes later."""
    cost: str = DEFAULT_MODEL
    """What stages take: a shipped model, or a file of `pglog calibrate` (.json)."""
    cost_scale: float = 1.0
    """The computer is so many times slower than the model's."""

    @property
    def speed(self) -> float:
        """The rate that holds; 0 is lock-step."""
        if self.rate is not None:
            return self.rate
        return 0.0 if self.budget_ms is None else 1.0

    def require_sound(self) -> None:
        """Raise a ProgroundError unless every figure makes sense."""
        rate, budget_ms = self.rate or 0.0, self.budget_ms
        complaints = {
            "--budget-ms": (budget_ms is None or 0 < budget_ms < math.inf, "more than 0"),
            "--rate": (0 <= rate < math.inf, "0 for lock-step, or more"),
            "--queue": (self.queue >= 1, "1 or more"),
            "--keyframe-every": (self.keyframe_every >= 1, "1 or more"),
            "--perceive-every": (self.perceive_every >= 1, "1 or more"),
        }
        for flag, (is_sound, wanted) in complaints.items():
            if not is_sound:
                value = getattr(self, flag[2:].replace("-", "_"))
                raise ProgroundError(f"cannot be {value:g}", where=flag, todo=f"give {wanted}")


@dataclass(frozen=True)
class ReplayConfig:
    """Everything that decides a replay, the log aside."""

    steps: int = 10
    """Optimisation steps a mapped frame gets."""
    seed: int = 0
    """Of every random draw."""
    device: Device = "auto"
    """What computes; auto: cuda where there is one."""
    selection: Annotated[Selection, tyro.conf.arg(name="")] = Selection()
    """Which frames of the log arrive."""
    max_frames: int | None = None
    """Stop after so many of them."""
    hold_out_every: int = 0
    """Keep every so many-th arriving frame from the mapper, for `pglog evaluate`; 0: none."""
    digest_every: int = 100
    """Steps between two fingerprints of the whole state in the ledger."""
    checkpoint_every: int = 50
    """Frames between two checkpoints, from which --resume goes on."""
    keep_checkpoints: bool = False
    """Keep all of them, for --from-checkpoint and `pglog bisect`."""
    simulation: Annotated[SimulationConfig, tyro.conf.arg(name="")] = SimulationConfig()
    kind: Annotated[str, tyro.conf.arg(name="mapper", metavar="KIND")] = NEURAL
    """What makes the map; its own settings are --mapper.NAME."""
    mapper: Any = NeuralConfig()
    telemetry: TelemetryConfig = TelemetryConfig()

    def learns(self, perception: PerceptionDescription | None) -> bool:
        """Whether meaning is learnt, where that is what regions mean."""
        return perception is not None and mapper_kind(self.kind).learns(self.mapper)

    def held_out(self, count: int) -> list[int]:
        """Numbers of the frames that a replay of a log of `count` frames keeps from the mapper."""
        every = self.hold_out_every
        chosen = self.selection.of(count)[: self.max_frames]
        return list(chosen[every - 1 :: every]) if every else []


class Setting(NamedTuple):
    """One setting of a dataclass or of one of its parts.

    Args:
        path: its dotted path, such as "mapper.sampling.rays".
        kind: its type.
        value: what it is set to.
    """

    path: str
    kind: Any
    value: Any


def walk(settings: Any, prefix: str = "") -> Iterator[Setting]:
    """Every setting of a dataclass, those of its parts among them, in the order of the fields."""
    hints = get_type_hints(type(settings))
    for field in dataclasses.fields(settings):
        path, value = prefix + field.name, getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from walk(value, f"{path}.")
        else:
            yield Setting(path, hints[field.name], value)


def kinds_of(settings: Any) -> dict[str, Any]:
    """The type of every setting by dotted path."""
    return {setting.path: setting.kind for setting in walk(settings)}


def flags(config: ReplayConfig) -> list[tuple[str, ...]]:
    """The options of `pglog replay` that give these settings, those that are not the default."""
    usual = {s.path: s.value for s in walk(with_kind(ReplayConfig(), config.kind))}
    given: list[tuple[str, ...]] = []
    if config.kind != NEURAL:
        given.append(("--mapper", config.kind))
    for path, _, value in walk(config):
        # The command line has the settings of these two parts without a prefix.
        name = path.removeprefix("selection.").removeprefix("simulation.").replace("_", "-")
        if value == usual[path]:
            continue
        if isinstance(value, bool):
            parent, _, last = name.rpartition(".")
            dot = "." if parent else ""
            given.append((f"--{parent}{dot}{'' if value else 'no-'}{last}",))
        else:
            given.append((f"--{name}", str(value)))
    return given


def config_from_dict(content: Mapping[str, Any]) -> ReplayConfig:
    """The settings of a replay from what `dataclasses.asdict` made of them.

    Raises:
        ProgroundError: nobody here knows the kind of mapper.
        TypeError: there is no such setting.
    """
    kind = content.get("kind", NEURAL)
    mapper: Any = from_dict(mapper_kind(kind).settings, content["mapper"])
    return from_dict(ReplayConfig, {**content, "kind": kind, "mapper": mapper})


def with_kind(config: ReplayConfig, kind: str) -> ReplayConfig:
    """The settings with another kind of mapper, which brings its own; see `mapper_kind`."""
    if kind == config.kind:
        return config
    return dataclasses.replace(config, kind=kind, mapper=mapper_kind(kind).settings())


def from_dict(kind: type[Part], content: Mapping[str, Any]) -> Part:
    """A settings dataclass from what `dataclasses.asdict` made of it; the rest keeps its default.

    Raises:
        TypeError: it has no such setting.
    """
    hints = get_type_hints(kind)
    values = {name: _read(hints.get(name), value) for name, value in content.items()}
    return kind(**values)


def _read(kind: Any, value: Any) -> Any:
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return from_dict(kind, value)
    # JSON has lists alone.
    return tuple(value) if isinstance(value, list) else value


def with_setting(part: Any, path: str, value: Value) -> Any:
    """A settings dataclass with the setting at a dotted path replaced."""
    if isinstance(part, ReplayConfig) and path == "kind":
        return with_kind(part, str(value))
    first, _, rest = path.partition(".")
    inner = with_setting(getattr(part, first), rest, value) if rest else value
    return dataclasses.replace(part, **{first: inner})


def shown(value: Value) -> str:
    """A value as it is written on the command line."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)
