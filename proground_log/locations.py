"""Places near and far: a path on this machine, or a URL that acts like one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from proground_log.errors import ProgroundError

INSTALL = "pip install 'proground-log[remote]'"


def located(text: str) -> Path:
    """The path that a text means; `s3://`, `gs://`, `https://` and others of fsspec are URLs.

    What comes back for a URL is a `UPath`, which has the methods of a `Path` that read and write.

    Raises:
        ProgroundError: what URLs need is not installed, nothing knows such URLs, or the store does
            not answer or let us in.
    """
    if "://" not in text:
        return Path(text)
    try:
        from upath import UPath

        path = cast(Path, UPath(text))
    except ImportError as error:
        raise ProgroundError(f"URLs need more ({error})", where=text, todo=INSTALL) from error
    except ValueError as error:
        todo = "use s3://, gs://, https:// or another that fsspec knows"
        raise ProgroundError(f"no such kind of URL ({error})", where=text, todo=todo) from error
    try:
        # Some say only of a file that is not there, and raise when asked for a folder.
        _ = path.exists() or path.is_dir()
    except ImportError as error:  # What one kind of store needs is asked for only now.
        raise ProgroundError(f"URLs need more ({error})", where=text, todo=INSTALL) from error
    except Exception as error:  # Each kind of store has errors of its own.
        reason = str(error) or type(error).__name__
        todo = "check the URL, the network and your credentials"
        raise ProgroundError(f"cannot be reached ({reason})", where=text, todo=todo) from error
    return path


def is_remote(path: Path) -> bool:
    """Whether a path is a URL."""
    return not isinstance(path, Path)


def is_same(first: Path, second: Path) -> bool:
    """Whether two paths are the same file that is there."""
    if is_remote(first) or is_remote(second):
        return str(first) == str(second)
    return first.exists() and second.exists() and first.samefile(second)


def upload(file: Path, path: Path) -> None:
    """Put a file of this machine where a URL says, whole or not at all."""
    remote: Any = path
    remote.fs.put_file(str(file), remote.path)
