"""The command line: parses, calls, prints. A file a group of commands.

Everything heavy is imported in the command that needs it, so that `pglog --help` answers at once.
"""

from __future__ import annotations

import os
import sys

from pglog import (
    ablate,
    bisect,
    calibrate,
    demo,
    diff,
    export,
    logs,
    navigate,
    objects,
    perception,
    query,
    record,
    recover,
    report,
    rerun,
    runs,
    sweep,
    view,
)
from pglog.common import FAILED, SAME, STOPPED
from pglog.parsing import Command, Group, description, parsed
from proground_log.errors import ProgroundError
from proground_log.version import __version__

COMMANDS: dict[str, Command | Group] = {
    "record": record.FORMAT_COMMANDS,
    "info": logs.info_command,
    "check": logs.check_command,
    "recover": recover.recover_command,
    "perceive": perception.perceive_command,
    "calibrate": calibrate.calibrate_command,
    "replay": runs.replay_command,
    "rerun": rerun.rerun_command,
    "diff": diff.diff_command,
    "bisect": bisect.bisect_command,
    "evaluate": runs.evaluate_command,
    "report": report.report_command,
    "query": query.query_command,
    "objects": objects.objects_command,
    "navigate": navigate.navigate_command,
    "ablate": ablate.ablate_command,
    "sweep": sweep.sweep_command,
    "export": export.export_command,
    "view": view.view_command,
    "demo": demo.demo_command,
    "vocabulary": perception.VOCABULARY_COMMANDS,
}
"""In the order of the help."""

PGLOG = Group(
    "Map RGB-D logs online, offline: record, replay, compare, look.\n\n"
    "pglog --version says which version this is.",
    {name: description(command) for name, command in COMMANDS.items()},
    COMMANDS.__getitem__,
)


def main() -> None:
    """Run a command; its result is the exit code."""
    if sys.argv[1:] == ["--version"]:
        print(f"proground-log {__version__}")
        sys.exit(SAME)
    try:
        code = parsed(PGLOG, sys.argv[1:])()
    except ProgroundError as error:
        print(f"pglog: {error}", file=sys.stderr)
        code = FAILED
    except BrokenPipeError:
        # Whoever reads the output (head, less) has seen enough; nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = FAILED
    except OSError as error:
        reason = f"{error.filename or 'pglog'}: {(error.strerror or str(error)).lower()}"
        print(f"pglog: {reason}; check the path and its permissions", file=sys.stderr)
        code = FAILED
    except KeyboardInterrupt as stop:
        print("; ".join(("pglog: stopped", *map(str, stop.args))), file=sys.stderr)
        code = STOPPED
    sys.exit(code)
