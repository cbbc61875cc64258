"""Which format a data set is, by what lies in its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from proground_log.errors import ProgroundError
from recorders.registry import FORMATS

NAMES_SHOWN, ENTRIES_TRIED = 8, 16


@dataclass(frozen=True)
class Detection:
    """What a path was recognised as.

    Args:
        format: a name of FORMATS.
        reason: what it was recognised by, such as "has results/ and traj.txt".
    """

    format: str
    reason: str


def detect(source: Path) -> Detection:
    """The one format that recognises a path; opens no image.

    Raises:
        ProgroundError: nothing is there, no format recognises it, or several do.
    """
    seen = _seen(source)
    found = _all(source)
    if len(found) == 1:
        return found[0]
    if found:
        reasons = " and ".join(f"{each.format} ({each.reason})" for each in found)
        raise ProgroundError(
            f"looks like {reasons}",
            where=source,
            todo="say which: pglog record FORMAT SOURCE",
        )
    for folder in _folders(source):
        for each in _all(folder):
            raise ProgroundError(
                f"is no data set that pglog knows, but has one in it ({seen})",
                where=source,
                todo=f"give {folder}, which looks like {each.format} ({each.reason})",
            )
    needs = "".join(
        f"\n  {name}: {each.description}" for name, each in FORMATS.items() if each.takes_source
    )
    raise ProgroundError(
        f"is no data set that pglog knows ({seen})",
        where=source,
        todo=f"give one of these, or say which it is, pglog record FORMAT SOURCE:{needs}",
    )


def _all(source: Path) -> list[Detection]:
    """Every format that recognises a path, in the order of the table."""
    return [
        Detection(name, reason)
        for name, each in FORMATS.items()
        if each.takes_source and (reason := each.recognise(source))
    ]


def _folders(source: Path) -> list[Path]:
    """Some of the folders in a folder, in which people may have meant to look."""
    inside = sorted(source.iterdir(), key=lambda path: path.name) if source.is_dir() else []
    return [path for path in inside[:ENTRIES_TRIED] if path.is_dir()]


def _seen(source: Path) -> str:
    """What is there, in a few words; raises a ProgroundError where nothing is, or no access."""
    try:
        if source.is_file():
            return f"a file of {source.stat().st_size} bytes"
        if not source.is_dir():
            raise ProgroundError("no such folder or file", where=source, todo="check the path")
        names = sorted(path.name for path in source.iterdir())
    except OSError as error:
        raise ProgroundError(
            "may not be read", where=source, todo="check the permissions"
        ) from error
    if not names:
        return "an empty folder"
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return f"a folder with {', '.join(names[:NAMES_SHOWN])}{more}"
