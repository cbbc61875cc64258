"""Commands as a user gives them, run in the test's own process; see the fixture `pglog`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Answer:
    """What a command gave."""

    code: int
    out: str
    err: str


Pglog = Callable[..., Answer]
