"""The cells of a sweep: every budget with every value of every setting, and every seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from itertools import product
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin
from urllib.parse import quote

from proground_log.errors import ProgroundError
from proground_log.run.settings import ReplayConfig, Value, kinds_of, shown, with_setting

Item = TypeVar("Item")

OWN_FLAGS = {"simulation.budget_ms": "--budget-ms", "seed": "--seed"}
"""Settings that a sweep has flags for."""


@dataclass(frozen=True)
class Axis:
    """A setting that is swept.

    Args:
        key: its dotted path in `ReplayConfig`.
        values: what it is set to, in this order.
    """

    key: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Cell:
    """One replay of a sweep.

    Args:
        name: tells it from the others; the name of its folder.
        config: all its settings.
        settings: those of the axes, by key.
    """

    name: str
    config: ReplayConfig
    settings: dict[str, Value]

    @property
    def budget_ms(self) -> float:
        """Simulated time that a mapped frame may take."""
        budget_ms = self.config.simulation.budget_ms
        assert budget_ms is not None
        return budget_ms


def read_budgets(text: str) -> tuple[float, ...]:
    """Budgets in milliseconds from "20,50"; raises a ProgroundError unless all are above 0."""
    budgets_ms = _list(text, "--budget-ms", _number)
    for budget_ms in budgets_ms:
        if budget_ms <= 0:
            raise ProgroundError(
                f"{shown(budget_ms)} ms is no budget", where="--budget-ms", todo="give more than 0"
            )
    return budgets_ms


def read_seeds(text: str) -> tuple[int, ...]:
    """Seeds from "0,1,2"; raises a ProgroundError unless they are whole numbers."""
    return _list(text, "--seed", _whole)


def read_axes(texts: Sequence[str], config: ReplayConfig = ReplayConfig()) -> tuple[Axis, ...]:
    """Settings from texts such as "mapper.sampling.rays=512,1024", or "mapper=neural,points".

    Args:
        texts: as on the command line.
        config: whose settings there are: each kind of mapper has its own.

    Raises:
        ProgroundError: there is no such setting (the nearest is named), a value is not of its
            type, or something is there twice.
    """
    kinds = kinds_of(config)
    axes: list[Axis] = []
    for text in texts:
        given, equals, values = text.partition("=")
        key, where = given.strip().replace("-", "_"), f"--set {text}"
        key = "kind" if key == "mapper" else key  # As the flag is called.
        if not equals:
            raise ProgroundError("has no values", where=where, todo="write --set KEY=VALUE,VALUE")
        if key in OWN_FLAGS:
            raise ProgroundError(
                f"{key} has a flag of its own", where=where, todo=f"use {OWN_FLAGS[key]}"
            )
        if key not in kinds:
            alike = [name for name in kinds if name.split(".")[-1] == key.split(".")[-1]]
            nearest = get_close_matches(key, alike or kinds, n=1, cutoff=0.0)[0]
            raise ProgroundError(
                f"there is no setting {given.strip()!r}",
                where=where,
                todo=f"the nearest is {nearest}",
            )
        if key in [axis.key for axis in axes]:
            raise ProgroundError(
                f"{key} is set twice", where=where, todo="give all its values at once"
            )
        axes.append(Axis(key, _list(values, where, partial(_value, kind=kinds[key]))))
    return tuple(axes)


def grid(
    base: ReplayConfig, budgets_ms: Sequence[float], seeds: Sequence[int], axes: Sequence[Axis]
) -> list[Cell]:
    """The cells in order: by budget, then by the settings as given, then by seed.

    Raises:
        ProgroundError: values that do not go together.
    """
    cells = []
    combinations = list(product(*(axis.values for axis in axes)))
    for budget_ms, values, seed in product(budgets_ms, combinations, seeds):
        settings = {axis.key: value for axis, value in zip(axes, values, strict=True)}
        simulation = replace(base.simulation, budget_ms=budget_ms)
        config = replace(base, seed=seed, simulation=simulation)
        # The kind comes first: it brings settings, which others may change.
        for key, value in sorted(settings.items(), key=lambda item: item[0] != "kind"):
            config = with_setting(config, key, value)
        parts = [f"{key}_{quote(shown(value), safe='')}" for key, value in settings.items()]
        name = "_".join([f"budget_{shown(budget_ms)}ms", *parts, f"seed_{seed}"])
        cells.append(Cell(name, config, settings))
    return cells


def _list(text: str, where: str, read: Callable[[str], Item]) -> tuple[Item, ...]:
    """Values between commas, none of them missing, wrong or there twice."""
    items: list[Item] = []
    for part in (part.strip() for part in text.split(",")):
        if not part:
            raise ProgroundError("a value is missing", where=where, todo="write them as 1,2,3")
        try:
            item = read(part)
        except ValueError as wanted:
            raise ProgroundError(
                f"{part!r} does not fit", where=where, todo=f"give {wanted}"
            ) from wanted
        if item in items:
            raise ProgroundError(f"{part} is there twice", where=where, todo="give it once")
        items.append(item)
    return tuple(items)


def _value(text: str, kind: Any) -> Value:
    """A value of a setting's type; raises a ValueError that says what would be one."""
    wanted = []
    for one in get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,):
        names = get_args(one)  # Those of a Literal.
        if one is str or text in names:
            return text
        if names:
            wanted.append(", ".join(names))
            continue
        try:
            return _READERS[one](text)
        except ValueError as error:
            wanted.append(str(error))
    raise ValueError(" or ".join(wanted))


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise ValueError("a whole number") from error


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError("a number")
    return number


def _truth(text: str) -> bool:
    if text not in ("true", "false"):
        raise ValueError("true or false")
    return text == "true"


def _nothing(text: str) -> None:
    if text != "none":
        raise ValueError("none")


_READERS: dict[type, Callable[[str], Value]] = {
    bool: _truth,
    int: _whole,
    float: _number,
    NoneType: _nothing,
}
"""What reads a value of each type; a ValueError says what would be one."""
