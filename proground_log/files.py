"""Files that are there, outputs that are free, and writing that leaves nothing half-done."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.locations import is_remote, upload

PARTIAL = ".partial"
"""What the name of a file ends in that is not yet whole."""

_REMEDIES = {
    errno.ENOSPC: "free some space or write elsewhere",
    errno.EDQUOT: "free some space or write elsewhere",
    errno.EFBIG: "raise the limit on file sizes or write elsewhere",
    errno.EACCES: "check the permissions",
    errno.EROFS: "write elsewhere",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def require_file(path: Path) -> Path:
    """Return `path`; raise a ProgroundError unless it is a file that is there."""
    if not path.is_file():
        what = "is a folder, not a file" if path.is_dir() else "no such file"
        if is_remote(path):
            what += ", or it cannot be reached"
        raise ProgroundError(what, where=path, todo="check the path")
    if not is_remote(path) and not os.access(path, os.R_OK):
        raise ProgroundError("may not be read", where=path, todo="check the permissions")
    return path


def nearest_above(folder: Path, name: str) -> Path | None:
    """The file of that name in the folder, else in the nearest folder above that has it."""
    place = folder.absolute()
    while not (place / name).is_file():
        if place == place.parent:
            return None
        place = place.parent
    return place / name


def require_free(path: Path, *, overwrite: bool) -> Path:
    """Return `path`; raise a ProgroundError when it exists and may not be replaced."""
    if path.is_dir():
        raise ProgroundError("the output is a folder", where=path, todo="name a file in it")
    if path.exists() and not overwrite:
        raise ProgroundError(
            "the output exists", where=path, todo="choose another name or pass --overwrite"
        )
    return path


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn what a disk refuses (full, read-only, forbidden) into a ProgroundError on `path`.

    An error on a file that is not `path`, a folder above it or a file named after it passes.
    """
    try:
        yield
    except OSError as error:
        at = str(path if error.filename is None else error.filename)
        is_ours = at.startswith(str(path)) or Path(at) in path.parents
        if error.errno is None or not is_ours:
            raise
        reason = os.strerror(error.errno).lower()
        raise ProgroundError(
            f"cannot write: {reason}",
            where=path,
            todo=_REMEDIES.get(error.errno, "check the path, or write elsewhere"),
        ) from error


def partial_of(path: Path, suffix: str = PARTIAL) -> Path:
    """Where a file is until it is whole: beside its final name, or here if that is a URL."""
    return Path(path.name + suffix) if is_remote(path) else path.with_name(path.name + suffix)


@contextmanager
def written_whole(
    path: Path, *, suffix: str = PARTIAL, kept_on: tuple[type[BaseException], ...] = ()
) -> Iterator[Path]:
    """Give a temporary path (`partial_of`) that takes its name only once it is written whole.

    On an error the temporary file is removed, so that nothing half-written ever stands under the
    final name.

    Args:
        path: the final name.
        suffix: what the temporary file is called besides.
        kept_on: errors that leave the temporary file where it is: what it holds is of use.
    """
    temporary = partial_of(path, suffix)
    with disk_errors(path):
        if not is_remote(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            if is_remote(path):
                upload(temporary, path)
                temporary.unlink()
            else:
                temporary.replace(path)
        except kept_on:
            raise
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def file_sha256(path: Path) -> str:
    """The sha256 of a file's bytes, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
