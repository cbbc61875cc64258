"""The order of names in which 9 comes before 10."""

from __future__ import annotations

import re


def natural_key(name: str) -> list[tuple[int, str]]:
    """A key that sorts names with the numbers in them as numbers, of any length.

    Names that differ in leading zeros alone go by their characters.

    >>> sorted(["b", "a10", "a9", "a09"], key=natural_key)
    ['a09', 'a9', 'a10', 'b']
    """
    pieces = re.split(r"(\d+)", name)  # Text and digits in turn.
    digits = [piece.lstrip("0") if index % 2 else piece for index, piece in enumerate(pieces)]
    # Of two numbers without leading zeros the one with more digits is larger.
    key = [(len(p) if i % 2 else 0, p) for i, p in enumerate(digits)]
    return [*key, (0, name)]
