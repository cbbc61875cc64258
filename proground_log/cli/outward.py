"""Commands that show or hand on what is there: export, view."""

from __future__ import annotations

from typing import Annotated

import tyro
from tyro.conf import Positional

from proground_log.cli.common import SAME, LogsAndRuns, Output, Run, err
from proground_log.errors import ProgroundError


def export_command(
    run: Run,
    what: Annotated[str, Positional, tyro.conf.arg(metavar="WHAT")],
    *,
    output: Output,
    voxel_m: float = 0.02,
    overwrite: bool = False,
) -> int:
    """Write the map for other tools.

    Args:
        run: folder of a finished run.
        what: mesh.
        output: the file to write (.ply).
        voxel_m: voxels of the mesh.
        overwrite: replace the output.
    """
    from proground_log.files import require_free
    from proground_log.mapping.map_file import load_map
    from proground_log.query.surface import extract_mesh, write_ply
    from replay.run_folder import RunFolder

    if what != "mesh":
        raise ProgroundError(f"there is no export {what!r}", where="export", todo="use mesh")
    require_free(output, overwrite=overwrite)
    with err.status("extracting the mesh"):
        mesh = extract_mesh(load_map(RunFolder(run).require_finished().map), voxel_m)
        write_ply(output, mesh)
    print(f"{output}: {len(mesh.vertices_m)} vertices, {len(mesh.faces)} faces")
    return SAME


def view_command(
    paths: LogsAndRuns = (),
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
    view(paths, web=web)
    return SAME
