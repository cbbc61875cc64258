"""What a text space is, and finding a text among those that one knows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from typing import Protocol

import numpy as np

from proground_log.errors import ProgroundError

NEAREST = 5
"""Known names that an error lists."""
_WORD = re.compile(r"[^\s/(),&]+")
_PLURALS = (("s", ""), ("es", ""), ("ies", "y"), ("ves", "f"), ("ves", "fe"))


class TextSpace(Protocol):
    """Turns texts into embeddings; whatever they are compared with must live in the same space."""

    @property
    def origin(self) -> dict[str, str]:
        """What it is, by keyword: kind, and where it is a file its name and sha256."""

    def embed(self, names: Sequence[str]) -> np.ndarray:
        """Embeddings float32 [N, 512] of length 1, each depending on its own text alone.

        Raises:
            ProgroundError: it does not know a text; names the nearest that it does.
        """


def of_length_1(embeddings: np.ndarray, where: object) -> np.ndarray:
    """Embeddings float32 [N, 512] brought to length 1.

    Raises:
        ProgroundError: one has no direction (it is 0 or not finite).
    """
    exact = embeddings.astype(np.float64)
    lengths = np.linalg.norm(exact, axis=1, keepdims=True)
    if not ((lengths > 0) & (lengths < np.inf)).all():
        raise ProgroundError(
            "gives an embedding that is 0 or not finite", where=where, todo="use another file"
        )
    return (exact / lengths).astype(np.float32)


class NameIndex:
    """Finds names as people write them: in any case, with any spaces, '_' or '-', in the plural.

    Args:
        names: the known ones; none twice (in any case, with any spaces), none empty.
        where: where they come from, for errors.

    Raises:
        ProgroundError: a name is empty or is there twice.
    """

    def __init__(self, names: Sequence[str], where: object) -> None:
        self._names, self._where = tuple(names), where
        self._rows: dict[str, int] = {}
        for row, name in enumerate(names):
            if not _spelled(name):
                raise self._fault("has an empty name")
            if self._rows.setdefault(_spelled(name), row) != row:
                raise self._fault(f"has the name {name!r} twice")
        # Second, for a known "bow-tie" must not take the place of a known "bow tie".
        for row, name in enumerate(names):
            self._rows.setdefault(_unhyphenated(name), row)

    def row(self, name: str) -> int:
        """The number of a name; raises a ProgroundError with the nearest ones if it is unknown."""
        for form in (_spelled(name), _unhyphenated(name), *_singulars(_unhyphenated(name))):
            if form in self._rows:
                return self._rows[form]
        nearest = ", ".join(map(repr, nearest_names(name, self._names)))
        raise ProgroundError(
            f"does not know {name!r}",
            where=self._where,
            todo=f"the nearest names that it knows are {nearest}",
        )

    def _fault(self, what: str) -> ProgroundError:
        return ProgroundError(what, where=self._where, todo="every name must be there once")


def nearest_names(name: str, known: Sequence[str]) -> list[str]:
    """Known names that are most like one in spelling and words, its singular too, best first."""
    asked = (_unhyphenated(name), *_singulars(_unhyphenated(name)))

    def likeness(candidate: str) -> float:
        return max(_likeness(form, _unhyphenated(candidate)) for form in asked)

    return sorted(known, key=lambda candidate: (-likeness(candidate), candidate))[:NEAREST]


def _likeness(first: str, second: str) -> float:
    """Likeness of spelling, from 0 to 1, plus half the share of words in common."""
    words, others = set(_WORD.findall(first)), set(_WORD.findall(second))
    shared = len(words & others) / max(len(words | others), 1)
    return SequenceMatcher(None, first, second, autojunk=False).ratio() + shared / 2


def _spelled(name: str) -> str:
    return " ".join(name.lower().split())


def _unhyphenated(name: str) -> str:
    return _spelled(name.replace("_", " ").replace("-", " "))


def _singulars(name: str) -> Iterator[str]:
    """What a name may be the plural of."""
    for ending, singular in _PLURALS:
        if name.endswith(ending):
            yield name.removesuffix(ending) + singular
