"""The command that lays a run out as a web page: report."""

from __future__ import annotations

from pathlib import Path

from pglog.common import SAME, Output, Run, shown_progress


def report_command(
    run: Run, *, output: Output, log: Path | None = None, overwrite: bool = False
) -> int:
    """Write a page about a run: its verdict, views, losses, budget, memory, objects, floor plan.

    Args:
        run: folder of a finished run.
        output: the page to write (.html); it needs no other file and no network.
        log: the run's log, where it has moved.
        overwrite: replace the page.
    """
    from proground_log.report.run_page import write_report

    with shown_progress("report") as progress:
        write_report(run, output, log, progress, overwrite=overwrite)
    print(f"{output}: {output.stat().st_size / 1e6:.1f} MB; open it in a browser")
    return SAME
