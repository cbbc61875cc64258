"""From a log to a run: deterministic, under a simulated budget of time."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from proground_log.run.settings import ReplayConfig
    from replay.divergence.rerun import rerun
    from replay.session import ReplayStoppedError, replay

__all__ = ["ReplayConfig", "ReplayStoppedError", "replay", "rerun"]

_HOMES = {
    "ReplayConfig": "proground_log.run.settings",
    "ReplayStoppedError": "replay.runner",
    "replay": "replay.session",
    "rerun": "replay.divergence.rerun",
}


def __getattr__(name: str) -> Any:
    """What is heavy is imported when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
