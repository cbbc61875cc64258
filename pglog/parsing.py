"""From the words of a command line to the call that they ask for."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from inspect import Signature, signature
from typing import Any, get_type_hints

import tyro

from pglog.common import REGISTRY, quiet
from pglog.mapper import asked_kind
from proground_log.errors import ProgroundError
from proground_log.run.settings import with_kind

Call = Callable[[], int]
"""A command with its arguments; what it gives is the exit code."""
Command = Callable[..., int]

CONFIG = (tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName)
COMPLETION = "--tyro-"
"""What the options begin with that make a shell complete command lines."""


@dataclass(frozen=True)
class Group:
    """Commands below one name.

    Args:
        description: what they are for.
        descriptions: what each one does, by name; the help lists these and builds no command.
        command: the command, or group, of a name.
        find_others: where else there is an option that a command of the group has not, such as
            "--stop is of ..."; None if nowhere.
    """

    description: str
    descriptions: Mapping[str, str]
    command: Callable[[str], Command | Group]
    find_others: Callable[[str], tuple[str, str] | None] = lambda _: None


def description(command: Command | Group) -> str:
    """What a command does, or the commands of a group."""
    return command.description if isinstance(command, Group) else command.__doc__ or ""


@dataclass(frozen=True)
class _AtHand:
    """What the first words of a command line name.

    Args:
        prog: these words, `pglog` before them.
        command: the command, or the group, that they name.
        group: the innermost group.
        words: the other words.
    """

    prog: str
    command: Command | Group
    group: Group
    words: Sequence[str]


def parsed(commands: Group, words: Sequence[str]) -> Call:
    """What a command line asks for, to be called.

    Only the command that is named is built: help comes faster, and what is said about a word that
    is wrong is about this command.

    Raises:
        ProgroundError: there is no such command or option.
        SystemExit: help was asked for and printed, or tyro has said what is wrong.
    """
    at_hand, kind = _at_hand(commands, words), asked_kind(words)
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            call = _call(at_hand, kind)
    except SystemExit as stop:
        if stop.code:
            _refuse_unknown_options(at_hand, kind)
        sys.stderr.write(said.getvalue())
        raise
    sys.stderr.write(said.getvalue())
    return call


def _at_hand(commands: Group, words: Sequence[str]) -> _AtHand:
    prog, group = "pglog", commands
    while words and not words[0].startswith("-"):
        name, *words = words
        if name not in group.descriptions:
            nearest = get_close_matches(name, group.descriptions, n=3, cutoff=0)
            raise ProgroundError(
                f"there is no `{prog} {name}`",
                where="command line",
                todo=f"the nearest are {', '.join(nearest)}; `{prog} --help` lists all",
            )
        prog, command = f"{prog} {name}", group.command(name)
        if not isinstance(command, Group):
            return _AtHand(prog, command, group, words)
        group = command
    return _AtHand(prog, group, group, words)


def _call(at_hand: _AtHand, kind: str) -> Call:
    command, words = at_hand.command, at_hand.words
    if isinstance(command, Group):
        is_whole = bool(words) and words[0].startswith(COMPLETION)
        call: Call = _app(command, kind, is_whole=is_whole).cli(
            prog=at_hand.prog,
            description=command.description,
            args=words,
            config=CONFIG,
            registry=REGISTRY,
        )
        return call
    return tyro.cli(
        as_parsed(command, kind), prog=at_hand.prog, args=words, config=CONFIG, registry=REGISTRY
    )


def _app(group: Group, kind: str, *, is_whole: bool) -> tyro.extras.SubcommandApp:
    """All commands of a group: with their arguments, or with what the help says of them."""
    app = tyro.extras.SubcommandApp()
    for name, description in group.descriptions.items():
        if not is_whole:
            app.command(name=name)(_described(description))
            continue
        command = group.command(name)
        if isinstance(command, Group):
            app.command(_app(command, kind, is_whole=True), name=name, help=description)
        else:
            app.command(name=name)(as_parsed(command, kind))
    return app


def _described(description: str) -> Command:
    def command() -> int:
        raise AssertionError("is never called: a command line that names it builds it")

    command.__doc__ = description
    return command


def as_parsed(command: Command, kind: str) -> Callable[..., Call]:
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


def _refuse_unknown_options(at_hand: _AtHand, kind: str) -> None:
    """Raise a ProgroundError with the nearest options if there is one that the command has not."""
    if isinstance(at_hand.command, Group):
        return
    options = _options(at_hand, kind)
    where = at_hand.prog.removeprefix("pglog ")
    for word in at_hand.words:
        option = word.partition("=")[0].replace("_", "-")
        if not option.startswith("--") or option in options:
            continue
        others = at_hand.group.find_others(option)
        if others is not None:
            raise ProgroundError(others[0], where=where, todo=others[1])
        nearest = get_close_matches(option, options, n=2)
        hint = f"did you mean {' or '.join(nearest)}? " if nearest else ""
        raise ProgroundError(
            f"there is no option {option}",
            where=where,
            todo=f"{hint}`{at_hand.prog} --help` lists all",
        )


def _options(at_hand: _AtHand, kind: str) -> list[str]:
    """The options of a command, as its help lists them."""
    with redirect_stdout(io.StringIO()) as help, suppress(SystemExit):
        _call(replace(at_hand, words=["--help"]), kind)
    return re.findall(r"^\W*(?:-\w \w+, )?(--[\w.-]+)", help.getvalue(), re.MULTILINE)
