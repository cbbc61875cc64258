"""The kind of mapper that a command line asks for: its settings are the command's options."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from proground_log.mapping.kinds import NEURAL

FLAG = "--mapper"


def asked_kind(words: Sequence[str]) -> str:
    """The kind that the words of a command line name, or the usual one."""
    kind = NEURAL
    for word, following in pairwise([*words, NEURAL]):
        if word == FLAG:
            kind = following
        elif word.startswith(f"{FLAG}="):
            kind = word.removeprefix(f"{FLAG}=")
    return kind
