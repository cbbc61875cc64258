"""proground-log: log-driven, offline-replayable online neural implicit mapping.

    import proground_log as pg

    run = pg.open_run("run")
    answer = run.query("chair")

What can be asked is in `proground_log.api`. It is imported when it is first asked for, so that
importing this package takes no time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from proground_log.errors import ProgroundError
from proground_log.version import __version__

if TYPE_CHECKING:
    from proground_log.api import Run, open_log, open_run

__all__ = ["ProgroundError", "Run", "__version__", "open_log", "open_run"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from proground_log import api

    return getattr(api, name)
