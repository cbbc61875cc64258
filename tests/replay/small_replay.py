"""What tests of determinism share."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from proground_log.events import Event, FrameDone
from proground_log.run.folder import RunFolder
from tests.replay.golden import COST

SMALL_FLAGS = [
    *("--steps", "3"),
    *("--hold-out-every", "5"),
    *("--digest-every", "4"),
    *("--checkpoint-every", "4"),
    *("--cost", COST),
    *("--mapper.field.log2-rows", "12"),
    *("--mapper.field.levels", "8"),
    *("--mapper.field.voxel-m", "0.05"),
    *("--mapper.sampling.rays", "128"),
    *("--mapper.sampling.uniform", "10"),
    *("--mapper.sampling.near-surface", "7"),
    *("--mapper.buffer.capacity", "3000"),
    *("--keyframe-every", "2"),
    *("--mapper.buffer.keyframe-samples", "900"),
    *("--telemetry.view-every", "4"),
    *("--telemetry.view-width", "40"),
    *("--telemetry.mesh-every", "8"),
    *("--telemetry.mesh-voxel-m", "0.15"),
]


class StopAfter:
    """Presses Ctrl-C after so many frames, as a user would: with a signal."""

    def __init__(self, frames: int) -> None:
        self._left = frames

    def on_event(self, event: Event) -> None:
        if isinstance(event, FrameDone):
            self._left -= 1
            if self._left == 0:
                os.kill(os.getpid(), signal.SIGINT)

    def close(self) -> None:
        pass


def ledger_bytes(run: Path) -> bytes:
    return RunFolder(run).ledger.read_bytes()


def replay_with_threads(log: Path, run: Path, threads: int) -> None:
    """A replay by the command, in a process of so many threads."""
    count = str(threads)
    command = [sys.executable, "-m", "pglog", "replay", str(log), "-o", str(run)]
    subprocess.run(
        [*command, "--threads", count, *SMALL_FLAGS],
        env={**os.environ, "NUMBA_NUM_THREADS": count, "OMP_NUM_THREADS": count},
        check=True,
        capture_output=True,
    )
