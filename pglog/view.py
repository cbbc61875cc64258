"""Command view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from pglog.common import SAME
from proground_log.errors import ProgroundError


def view_command(
    paths: Annotated[tuple[Path, ...], Positional, tyro.conf.arg(metavar="[LOG|RUN ...]")] = (),
    *,
    web: bool = False,
) -> int:
    """Open logs and runs in the rerun viewer.

    Args:
        paths: logs (.mcap) or folders of runs.
        web: serve the viewer to a browser on this machine instead of opening a window.
    """
    from proground_log.telemetry.viewer import view

    if not paths:
        raise ProgroundError(
            "there is nothing to open", where="view", todo="give logs (.mcap) or folders of runs"
        )
    for path in paths:
        if not path.exists():
            raise ProgroundError("no such log or run", where=path, todo="check the path")
    view(paths, web=web)
    return SAME
