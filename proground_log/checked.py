"""What a file of settings holds, JSON or TOML, checked value by value: what is wrong is named."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

from proground_log.errors import ProgroundError


class Checks(NamedTuple):
    """Checks of one file's values; each raises a ProgroundError, which calls the value `what`.

    Args:
        where: the file, for messages.
        todo: what to do about a wrong one.
    """

    where: object
    todo: str

    def fault(self, what: str) -> ProgroundError:
        """The error to raise."""
        return ProgroundError(what, where=self.where, todo=self.todo)

    def entries(
        self,
        value: object,
        what: str,
        known: Collection[str] | None = None,
        needed: Collection[str] = (),
    ) -> dict[str, Any]:
        """Values by name, of names that are known, among them all that are needed."""
        if not isinstance(value, dict):
            raise self.fault(f"{what} is {type(value).__name__}, not entries by name")
        for name in sorted(set(needed) - set(value)):
            raise self.fault(f"{what} has no entry {name!r}")
        for name in sorted(set(value) - set(value if known is None else known)):
            raise self.fault(f"{what} has an unknown entry {name!r}")
        return value

    def text(self, value: object, what: str) -> str:
        """A text with something in it."""
        if not isinstance(value, str) or not value.strip():
            raise self.fault(f"{what} is {value!r}, not a text")
        return value

    def number(self, value: object, what: str, most: float) -> float:
        """A number from 0 to the most."""
        # A number that is none (NaN) fails the comparison too.
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= most:
            raise self.fault(f"{what} is {value!r}, not a number from 0 to {most:g}")
        return float(value)
