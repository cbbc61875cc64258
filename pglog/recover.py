"""Command recover."""

from __future__ import annotations

import dataclasses
import json

from pglog.common import SAME, AsJson, Log, Output, print_table, shown_progress


def recover_command(
    log: Log, *, output: Output, overwrite: bool = False, as_json: AsJson = False
) -> int:
    """Save the whole frames of a log that is damaged, cut off or unfinished (.partial).

    Args:
        log: the log; it is not changed.
        output: the log to write (.mcap).
        overwrite: replace the output.
        as_json: print JSON, for programs.
    """
    from recorders.recover import recover

    with shown_progress("recover") as progress:
        recovery = recover(log, output, overwrite=overwrite, progress=progress)
    if as_json:
        print(json.dumps(dataclasses.asdict(recovery), indent=2))
        return SAME
    print(f"{output}: {recovery}")
    if recovery.damage:
        places = {str(number): place for number, place in enumerate(recovery.damage, start=1)}
        print_table("damaged", places)
    for keyword, note in recovery.notes.items():
        print(f"  {keyword}: {note}")
    return SAME
