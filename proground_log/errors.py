"""The one kind of error that a user can cause."""

from __future__ import annotations


class ProgroundError(Exception):
    """Something the user can mend: says what is wrong, where, and what to do.

    Args:
        what: the fault, in a clause without a full stop.
        where: the file, frame or topic at fault.
        todo: what the user can do about it.
    """

    def __init__(self, what: str, *, where: object, todo: str) -> None:
        super().__init__(what, str(where), todo)
        self.what, self.where, self.todo = what, str(where), todo

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.todo}"
