"""The box that a map fills."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proground_log.errors import ProgroundError


@dataclass(frozen=True)
class Bounds:
    """An axis-aligned box in the world, in metres.

    >>> room = Bounds((0.0, 0.0, 0.0), (4.0, 3.0, 2.5))
    >>> room.contains(np.array([[1.0, 1.0, 1.0], [5.0, 1.0, 1.0]])).tolist()
    [True, False]
    """

    lower_m: tuple[float, float, float]
    upper_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        size_m = np.subtract(self.upper_m, self.lower_m)
        if not (np.isfinite(size_m).all() and (size_m > 0).all()):
            raise ProgroundError(
                f"the bounds {self.lower_m} to {self.upper_m} enclose nothing",
                where="bounds",
                todo="record the log again, or give bounds whose upper corner is the larger",
            )

    @property
    def size_m(self) -> np.ndarray:
        """Length of the sides, float64 [3]."""
        return np.subtract(self.upper_m, self.lower_m)

    def contains(self, points_m: np.ndarray) -> np.ndarray:
        """Which of the points [..., 3] lie inside, bool [...]."""
        inside = (points_m >= self.lower_m) & (points_m <= self.upper_m)
        return np.asarray(inside.all(axis=-1))
