"""One recording out of the segments that an interrupted and resumed replay left."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.files import require_file, written_whole


def merge_segments(segments: Sequence[Path], output: Path) -> None:
    """Write one .rrd file, with a footer, that holds what the segments hold.

    Rerun's own merge is used, and not its chunk reader: only that reads a segment whose process
    was killed in the middle of a message. What such a segment holds up to there is kept. Rows
    that two segments both hold, since work after a checkpoint was done again, stay double; they
    are equal and lie at equal times.

    Args:
        segments: .rrd files of one recording id, oldest first.
        output: the file to write; may be one of the segments.

    Raises:
        ProgroundError: there is nothing to merge, or a segment is damaged.
    """
    sources = [path for path in map(require_file, segments) if path.stat().st_size]
    if not sources:
        raise ProgroundError(
            "no telemetry to merge", where=output, todo="replay again with --overwrite"
        )
    with written_whole(output) as temporary:
        command = [sys.executable, "-m", "rerun", "rrd", "merge", *map(str, sources)]
        result = subprocess.run(
            [*command, "-o", str(temporary)], capture_output=True, text=True, check=False
        )
        if result.returncode:
            raise ProgroundError(
                f"the telemetry cannot be merged: {_last_line(result.stderr)}",
                where=", ".join(map(str, sources)),
                todo="see that the disk has room and go on with --resume, "
                "or replay again with --overwrite",
            )


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "rerun gave no reason"
