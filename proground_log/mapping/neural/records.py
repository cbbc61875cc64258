"""Frozen dataclasses whose fields are arrays with a row for each of the same things."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

Record = TypeVar("Record", bound=Any)


def take_rows(record: Record, rows: np.ndarray) -> Record:
    """The record with these rows of every field."""
    return type(record)(*(getattr(record, f.name)[rows] for f in fields(record)))


def joined(first: Record, second: Record) -> Record:
    """Both records of a kind, one after the other."""
    pairs = ((getattr(first, f.name), getattr(second, f.name)) for f in fields(first))
    return type(first)(*(np.concatenate(pair) for pair in pairs))
