"""The kind of mapper that a command line asks for: its settings are the command's options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import FunctionType
from typing import cast

from proground_log.mapping.kinds import NEURAL
from proground_log.run.settings import with_kind

FLAG = "--mapper"


def asked_kind(words: Sequence[str]) -> str:
    """The kind that the words of a command line name, or the usual one."""
    kind = NEURAL
    for number, word in enumerate(words):
        if word == FLAG:
            kind = words[number + 1] if number + 1 < len(words) else NEURAL
        elif word.startswith(f"{FLAG}="):
            kind = word.removeprefix(f"{FLAG}=")
    return kind


def with_settings_of(command: Callable[..., int], kind: str) -> Callable[..., int]:
    """A command whose `config`, if it has one, is that of another kind of mapper.

    Raises:
        ProgroundError: there is no such kind, or its package cannot be imported.
    """
    function = cast(FunctionType, command)
    usual = function.__kwdefaults__ or {}
    if kind == NEURAL or "config" not in usual:
        return command
    copy = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__doc__, copy.__annotations__ = function.__doc__, function.__annotations__
    copy.__kwdefaults__ = {**usual, "config": with_kind(usual["config"], kind)}
    return cast(Callable[..., int], copy)
