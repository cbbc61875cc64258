"""What a folder holds, to tell formats apart."""

from __future__ import annotations

from pathlib import Path


def holds(folder: Path, *patterns: str) -> bool:
    """Whether a folder has something for each of the patterns of `Path.glob`."""
    return all(any(True for _ in folder.glob(pattern)) for pattern in patterns)
