"""How far apart numbers are that should be equal: in units in the last place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TensorDifference:
    """Two tensors of a name that are not equal, bit for bit.

    Args:
        first, second: data type and shape of each, such as "float32 [4, 2]", or "absent".
        differing: elements that differ; None where types or shapes do.
        size: elements of each, likewise.
        distance: the largest number of representable values between corresponding elements: ulp
            for floats, the plain difference for whole numbers.
    """

    first: str
    second: str
    differing: int | None = None
    size: int | None = None
    distance: int | None = None

    def __str__(self) -> str:
        if self.differing is None:
            return f"{self.first} | {self.second}"
        unit = "ulp" if self.first.startswith("float") else "steps"
        return f"{self.differing} of {self.size} values, up to {self.distance} {unit}"


def ulp_distance(first: np.ndarray | np.generic, second: np.ndarray | np.generic) -> int:
    """Largest number of values of the type between corresponding elements.

    -0 and +0 are neighbours, so that the distance is 0 only where the bits are equal.

    Args:
        first, second: of the same shape and the same type: float, whole or bool.
    """
    a, b = _ordered(np.atleast_1d(first)), _ordered(np.atleast_1d(second))
    return int((np.maximum(a, b) - np.minimum(a, b)).max(initial=0))


def tensor_differences(
    first: dict[str, np.ndarray], second: dict[str, np.ndarray]
) -> dict[str, TensorDifference]:
    """The tensors that differ in a bit, or that only one has, by name and in the first's order."""
    differences = {}
    for name in [*first, *(name for name in second if name not in first)]:
        difference = _difference(first.get(name), second.get(name))
        if difference is not None:
            differences[name] = difference
    return differences


def _difference(first: np.ndarray | None, second: np.ndarray | None) -> TensorDifference | None:
    kinds = _kind(first), _kind(second)
    if first is None or second is None or kinds[0] != kinds[1]:
        return TensorDifference(*kinds)
    differing = int((_ordered(first) != _ordered(second)).sum())
    if not differing:
        return None
    return TensorDifference(*kinds, differing, first.size, ulp_distance(first, second))


def _kind(array: np.ndarray | None) -> str:
    return "absent" if array is None else f"{array.dtype} {list(array.shape)}"


def _ordered(values: np.ndarray) -> np.ndarray:
    """Whole numbers that count up with the values, uint64."""
    width = values.dtype.itemsize
    bits = np.ascontiguousarray(values).view(f"u{width}").astype(np.uint64)
    sign, full = np.uint64(1 << (8 * width - 1)), np.uint64((1 << (8 * width)) - 1)
    match values.dtype.kind:
        case "f":  # The bits of negative floats count the other way.
            return np.where(bits & sign, full - bits, bits | sign)
        case "i":
            return bits ^ sign
    return bits
