"""How this package compiles its loops: exact float64, the same bits at any number of threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile without fast-math, so that every operation rounds as IEEE 754 says."""
    return cast(Function, njit(cache=True, error_model="numpy")(function))


def compiled_parallel(function: Function) -> Function:
    """Compile with `prange` over independent outputs; nothing is summed across threads."""
    return cast(Function, njit(cache=True, error_model="numpy", parallel=True)(function))
