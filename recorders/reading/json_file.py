"""JSON from data sets: numbers exact, as they were written, and broken files named."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.errors import ProgroundError
from recorders.reading.association import read_text

REMEDY = "mend the file, or take it from the data set again"


def read_json(path: Path) -> Any:
    """What a JSON file holds, as `parse_json`."""
    return parse_json(read_text(path), where=path)


def parse_json(text: str, *, where: object) -> Any:
    """What a JSON text holds; numbers with a fraction are `Decimal`, so that times stay exact.

    Raises:
        ProgroundError: it is not JSON.
    """
    try:
        return json.loads(text, parse_float=Decimal)
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise ProgroundError(f"is not JSON ({error})", where=where, todo=REMEDY) from error


def numbers(value: object, shape: tuple[int, ...], *, what: str, where: object) -> np.ndarray:
    """Nested lists of numbers as an array, float64 of a shape in which -1 stands for any length.

    A null or a number that is none (NaN) becomes NaN.

    Args:
        value: out of `parse_json`.
        shape: the array's; lists of lists may be flat instead.
        what: what the numbers are, for messages.
        where: the file, for messages.

    Raises:
        ProgroundError: other than numbers, or not as many.
    """
    try:
        return np.array(value, dtype=np.float64).reshape(shape)
    except (ValueError, TypeError, ArithmeticError) as error:
        size = " x ".join("any" if length < 0 else str(length) for length in shape)
        raise ProgroundError(f"{what} is not {size} numbers", where=where, todo=REMEDY) from error
