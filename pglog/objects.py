"""The command that lists what is in a map: objects."""

from __future__ import annotations

import json
from pathlib import Path

from rich.table import Column, Table

from pglog.common import SAME, AsJson, Run, err, out, warn
from proground_log.query.voxels import OBJECTS_VOXEL_M


def objects_command(
    run: Run,
    *,
    voxel_m: float = OBJECTS_VOXEL_M,
    as_json: AsJson = False,
    csv: Path | None = None,
    rrd: Path | None = None,
    overwrite: bool = False,
    log: Path | None = None,
) -> int:
    """List the objects in a map: what they are, where, how large, how sure, how often seen.

    Args:
        run: folder of a finished run, of a log with regions.
        voxel_m: voxels of the surface that is asked.
        as_json: print JSON, for programs.
        csv: a table to write (.csv).
        rrd: a recording of the objects to write, for rerun (.rrd).
        overwrite: replace these files.
        log: the run's log, where it has moved: it tells objects apart.
    """
    from proground_log.exports.objects import object_rows, place_text, write_objects_csv
    from proground_log.files import require_free
    from proground_log.query.surface import Surfaces
    from proground_log.run.opened import OpenedRun
    from proground_log.telemetry.objects_recording import draw_objects

    for output in (csv, rrd):
        if output is not None:
            require_free(output, overwrite=overwrite)
    with err.status("asking the map"):
        opened = OpenedRun.finished(run, log)
        opened.require_meaning()
        surface = Surfaces(opened).at(voxel_m)
        objects = surface.objects
        if csv is not None:
            write_objects_csv(csv, objects)
        if rrd is not None:
            draw_objects(rrd, surface)
    if surface.caveat:
        warn(surface.caveat)
    if as_json:
        print(json.dumps(object_rows(objects), indent=2))
        return SAME
    table = Table(
        Column("", justify="right"),
        Column("object", overflow="fold"),
        *(Column(name, justify="right") for name in ("position m", "extent m", "score")),
        Column("views", justify="right"),
    )
    for number, thing in enumerate(objects, start=1):
        table.add_row(
            str(number),
            thing.label,
            place_text(thing.position_m),
            place_text(thing.box.extent_m, "x"),
            f"{thing.score:.2f}",
            "" if thing.views is None else str(thing.views),
        )
    if objects:
        out.print(table)
    else:
        print("no object of the task's prompts is in the map")
    if rrd is not None:
        print(f"look at it: pglog view {rrd}")
    return SAME
