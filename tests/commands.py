"""Commands as a user gives them, run in the test's own process; see the fixture `pglog`."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Answer:
    """What a command gave."""

    code: int
    out: str
    err: str


Pglog = Callable[..., Answer]


def assert_one_clear_line(answer: Answer, *parts: str) -> None:
    """What, where and what to do in one line, and nothing else."""
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert re.fullmatch(r"pglog: .+: .+; .+\n", answer.err), answer.err
    for part in parts:
        assert part in answer.err
