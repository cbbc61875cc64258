"""The kind of mapper that a command line asks for: its settings are the command's options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from inspect import Signature, signature
from itertools import pairwise
from typing import Any, get_type_hints

from pglog.common import quiet
from proground_log.mapping.kinds import NEURAL
from proground_log.run.settings import with_kind

FLAG = "--mapper"
Call = Callable[[], int]
"""A command with its arguments; what it gives is the exit code."""


def asked_kind(words: Sequence[str]) -> str:
    """The kind that the words of a command line name, or the usual one."""
    kind = NEURAL
    for word, following in pairwise([*words, NEURAL]):
        if word == FLAG:
            kind = following
        elif word.startswith(f"{FLAG}="):
            kind = word.removeprefix(f"{FLAG}=")
    return kind


def as_parsed(command: Callable[..., int], kind: str) -> Callable[..., Call]:
    """What a command line is parsed into: a command's arguments, and the call that they make.

    Its `config`, if it has one, is that of the kind of mapper.

    Raises:
        ProgroundError: there is no such kind, or its package cannot be imported.
    """
    hints = get_type_hints(command, include_extras=True)
    parameters = []
    for name, parameter in signature(command).parameters.items():
        default = parameter.default
        if name == "config":
            default = with_kind(default, kind)
        parameters.append(
            parameter.replace(annotation=quiet(hints[name], default), default=default)
        )

    def arguments(*positional: Any, **named: Any) -> Call:
        return partial(command, *positional, **named)

    arguments.__name__, arguments.__doc__ = command.__name__, command.__doc__
    arguments.__annotations__ = {each.name: each.annotation for each in parameters}
    arguments.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return arguments
