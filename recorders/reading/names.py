"""Names of files that a data set gives, which may be hostile."""

from __future__ import annotations

from pathlib import PurePosixPath

LONGEST_PART_BYTES = 255
LONGEST_BYTES = 2**11
"""What file systems take, with room for the folder before it."""


def is_inside(name: str) -> bool:
    """Whether a name leads to a place within the data set's folder, and could be a file's.

    >>> is_inside("depth/0001.png"), is_inside("../../etc/passwd"), is_inside("/etc/passwd")
    (True, False, False)
    """
    path = PurePosixPath(name)
    parts = [part.encode(errors="surrogatepass") for part in path.parts]
    return (
        bool(path.name)
        and not path.is_absolute()
        and ".." not in path.parts
        and "\0" not in name
        and len(b"/".join(parts)) <= LONGEST_BYTES
        and all(len(part) <= LONGEST_PART_BYTES for part in parts)
    )
