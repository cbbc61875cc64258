"""Calibration: measure on this machine what each stage of a replay takes, for a cost model.

Each stage runs at several sizes, in the state it has in the middle of a replay; a line
fixed + per_unit * units is laid through the medians. The inputs are the same every time, only the
measured times vary.
"""

from __future__ import annotations

import itertools
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import nnls

from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.mapping.kinds import NEURAL, StageCost
from proground_log.perception.perceiver import Perceiver
from proground_log.run.cost_model import UNITS, CostModel
from replay.calibration.work import stage_works
from replay.device import choose_device

REPEATS = 15
OTHER_UNIT = "pixel"
"""Of a stage of a mapper of somebody else, which is measured by the size of its frames."""
MOST_RESIDUAL_PERCENT = 15.0
LEAST_R_SQUARED = 0.9
REAL_SPREAD = 1.5
"""Where the longest time is less than so many times the shortest, R^2 tells of noise alone."""


@dataclass(frozen=True)
class Points:
    """What was measured of a stage.

    Args:
        units: sizes, see `cost_model.UNITS`.
        times_ns: the median time at each of them.
    """

    units: tuple[int, ...]
    times_ns: tuple[float, ...]


class Line(NamedTuple):
    """A line fixed_ns + per_unit_ns * units through points.

    Args:
        fixed_ns, per_unit_ns: neither below 0.
        residuals: of each point, how far the line lies off, as a share of the point's time.
        r_squared: share of the times' variance that the line explains.
    """

    fixed_ns: float
    per_unit_ns: float
    residuals: np.ndarray
    r_squared: float


def measure(
    reader: LogReader,
    *,
    perceiver: Perceiver | None = None,
    kind: str = NEURAL,
    repeats: int = REPEATS,
    progress: Callable[[int, int], None],
) -> dict[str, Points]:
    """Measure every stage on the CPU, on the threads that torch and numba are set to.

    Args:
        reader: a log of the built-in room, see `stage_works`.
        perceiver: the perception to measure; None leaves the stage out.
        kind: the mapper whose stages are measured.
        repeats: calls at each size, of which the median counts.
        progress: told how much is done, and of how much.

    Returns:
        The points by stage.
    """
    choose_device("cpu")  # As a replay does: torch computes deterministically.
    with tempfile.TemporaryDirectory(prefix="pglog-") as folder:
        stages = stage_works(reader, perceiver, Path(folder), kind)
        total = len(stages) * (1 + repeats)
        points: dict[str, Points] = {}
        done = itertools.count(1)
        progress(0, total)
        for stage, prepare in stages.items():
            works = prepare()
            for work in works:  # To warm up.
                work.run()
            progress(next(done), total)
            taken_ns: list[list[float]] = [[] for _ in works]
            for _ in range(repeats):
                # In turn, so that what else the machine does hits all sizes alike.
                for work, taken in zip(works, taken_ns, strict=True):
                    start_ns = time.perf_counter_ns()
                    work.run()
                    taken.append((time.perf_counter_ns() - start_ns) / work.times)
                progress(next(done), total)
            points[stage] = Points(
                tuple(work.units for work in works), tuple(map(statistics.median, taken_ns))
            )
    return points


def cost_model(name: str, points: dict[str, Points], measured: str) -> CostModel:
    """The cost model of this machine from what was measured on it.

    Args:
        name: what to call it.
        points: as from `measure`.
        measured: how, in words.

    Raises:
        ProgroundError: the points of a stage lie on no line.
    """
    stages = {stage: stage_cost(stage, some) for stage, some in points.items()}
    hardware = {
        "processor": _processor_name(),
        "cores": str(os.cpu_count()),
        "threads": str(torch.get_num_threads()),
    }
    return CostModel(name, hardware, measured, stages)


def how_measured(repeats: int, perceived_with: str | None) -> str:
    """In words how a cost model was measured.

    Args:
        repeats: as given to `measure`.
        perceived_with: what perception it was; None where it was not measured.
    """
    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "numba", "onnxruntime"))
    perceived = f", perceived with {perceived_with}" if perceived_with else ""
    return f"the built-in room{perceived}; medians of {repeats} calls a size; {packages}"


def stage_cost(stage: str, points: Points) -> StageCost:
    """The cost of a stage; raises a ProgroundError where its points lie on no line."""
    line = fit_line(points)
    residual_percent = 100 * float(np.median(np.abs(line.residuals)))
    spread = max(points.times_ns) / min(points.times_ns)
    poor = spread > REAL_SPREAD and line.r_squared < LEAST_R_SQUARED
    if poor or residual_percent > MOST_RESIDUAL_PERCENT:
        raise ProgroundError(
            f"the times of {stage} lie on no line: off by {residual_percent:.0f} %, "
            f"R² {line.r_squared:.2f}",
            where="calibrate",
            todo="close other programs, and try again",
        )
    return StageCost(
        _of_four_digits(line.fixed_ns),
        _of_four_digits(line.per_unit_ns),
        UNITS.get(stage, OTHER_UNIT),
        round(residual_percent, 1),
    )


def fit_line(points: Points) -> Line:
    """Lay a line through points so that the squares of the relative errors are least."""
    units, times_ns = (np.array(p, np.float64) for p in (points.units, points.times_ns))
    scale = units.max()  # Both unknowns become times, alike in size.
    (fixed_ns, scaled_ns), _ = nnls(
        np.stack([1 / times_ns, units / scale / times_ns], axis=1), np.ones(len(units))
    )
    errors_ns = fixed_ns + scaled_ns * units / scale - times_ns
    variance = ((times_ns - times_ns.mean()) ** 2).sum()
    r_squared = 1.0 if variance == 0 else 1 - (errors_ns**2).sum() / variance
    return Line(float(fixed_ns), float(scaled_ns / scale), errors_ns / times_ns, float(r_squared))


def _of_four_digits(number: float) -> float:
    """What a measurement is worth, and a file easy to read."""
    return float(f"{number:.4g}")


def _processor_name() -> str:
    """What the processor calls itself; Python knows only its family on Linux."""
    info = Path("/proc/cpuinfo")
    for line in info.read_text().splitlines() if info.is_file() else ():
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    return platform.processor() or platform.machine()
