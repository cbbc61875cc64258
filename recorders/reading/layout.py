"""What a folder holds, to tell formats apart."""

from __future__ import annotations

from pathlib import Path


def holds(folder: Path, *patterns: str) -> bool:
    """Whether a folder has something for each of the patterns of `Path.glob`; never an error.

    No too where the path is a file, is not there, or may not be looked into.
    """
    try:
        return all(any(True for _ in folder.glob(pattern)) for pattern in patterns)
    except Exception:  # each remote file system has errors of its own, and the answer is the same
        return False
