"""The formats that can be recorded, as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import cast

from proground_log.errors import ProgroundError
from recorders.source import Source


@dataclass(frozen=True)
class Format:
    """A format that can be recorded.

    Args:
        module, class_name: where its Source is; imported only when it is opened.
        description: one line for people, with what SOURCE has to be.
        takes_source: whether it reads a data set, the class's first argument, or makes one up.
    """

    module: str
    class_name: str
    description: str
    takes_source: bool = True

    def opener(self) -> Callable[..., Source]:
        """The class; beside the source, its arguments are the format's options."""
        return cast(Callable[..., Source], getattr(import_module(self.module), self.class_name))


FORMATS = {
    "seven-scenes": Format(
        "recorders.seven_scenes",
        "SevenScenesSource",
        "7-Scenes or 3DMatch: a folder of frame-*.{color,depth,pose}.*",
    ),
    "tum": Format(
        "recorders.tum", "TumSource", "TUM RGB-D: a folder with rgb.txt, depth.txt, groundtruth.txt"
    ),
    "replica": Format(
        "recorders.replica",
        "ReplicaSource",
        "Replica, NICE-SLAM's layout: a folder with results/ and traj.txt",
    ),
    "synthetic": Format(
        "recorders.room", "RoomSource", "the built-in furnished room, no source", takes_source=False
    ),
}


def open_source(name: str, source: Path | None = None, **options: object) -> Source:
    """Open a data set.

    Args:
        name: one of FORMATS.
        source: what the format's description asks for; None for a format that takes none.
        options: keyword arguments of the format's class, such as `calibration`.

    Raises:
        ProgroundError: no such format or option, or the data set is at fault.
    """
    chosen = FORMATS[_known("format", name, FORMATS, where=source or "record")]
    opener = chosen.opener()
    valid_options = list(signature(opener).parameters)[int(chosen.takes_source) :]
    for option in options:
        _known("option", option, valid_options, where=f"format {name}")
    if chosen.takes_source != (source is not None):
        todo = chosen.description if chosen.takes_source else "leave the source out"
        what = "needs a source" if chosen.takes_source else f"has no use for {source}"
        raise ProgroundError(what, where=f"format {name}", todo=todo)
    return opener(source, **options) if chosen.takes_source else opener(**options)


def _known(kind: str, name: str, valid: Iterable[str], *, where: object) -> str:
    """Return the name; raise a ProgroundError with the valid ones unless it is one of them."""
    names = sorted(valid)
    if name not in names:
        nearest = get_close_matches(name, names, n=1)
        hint = f"did you mean {nearest[0]}? " if nearest else ""
        raise ProgroundError(
            f"there is no {kind} {name!r}", where=where, todo=f"{hint}valid: {', '.join(names)}"
        )
    return name
