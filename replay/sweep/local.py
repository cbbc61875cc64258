"""The engine of a sweep on this computer: a process a cell, one thread each."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event

from replay.device import set_threads
from replay.sweep.cells import Job, attempt, require_workers


class LocalEngine:
    """Computes cells in processes of their own.

    Args:
        workers: cells at once; None: one a core.
    """

    def __init__(self, workers: int | None = None) -> None:
        require_workers(workers)
        self.places = workers or _cores()
        self._context = get_context("spawn")
        self._stop = self._context.Event()

    def run(self, job: Job) -> str | None:
        """Do a job; returns why it failed, or None."""
        # A process is not used twice: what one cell leaves behind, such as its peak of memory,
        # is of no concern to the next, and one that is killed takes no other cell with it.
        with ProcessPoolExecutor(1, self._context, _begin, (self._stop,)) as process:
            try:
                return process.submit(_attempt, job).result()
            except BrokenProcessPool:
                return f"{job.folder}: its process was killed; is there enough memory?"

    def stop(self) -> None:
        """Let all jobs stop after the frame at hand."""
        self._stop.set()


def _cores() -> int:
    """Cores that this process may use; macOS does not tell, and has all of them."""
    affinity = getattr(os, "sched_getaffinity", None)
    return (os.cpu_count() or 1) if affinity is None else len(affinity(0))


_stop: Event
"""In a worker: whether it shall stop. Events reach a process only as it begins."""


def _begin(stop: Event) -> None:
    global _stop
    _stop = stop
    set_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Leave nothing running when the sweep is killed; the cell is resumed by the next one."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _attempt(job: Job) -> str | None:
    return attempt(job, _stop.is_set)
