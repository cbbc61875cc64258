"""Doing the next pieces of work while this one is being used."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 8
"""Frames ahead: a chunk of a log, which is compressed in one go, holds some four."""
MOST_JOBS = 4
"""More would wait for the one thread that writes."""


def default_jobs() -> int:
    """Threads that a recording can use on this machine."""
    return min(MOST_JOBS, os.cpu_count() or 1)


def prefetched(
    work: Callable[[Item], Result], items: Iterable[Item], jobs: int
) -> Iterator[Result]:
    """The results of `work` on each item, in order, some items ahead in other threads.

    Decoding and compressing images release Python's lock, so that cores share the work. An error
    is raised where its result would have been. The results do not depend on the number of jobs.

    Args:
        work: may run in several threads at once.
        items: what it is given.
        jobs: threads, the one that uses the results included; 1 does all in this one.
    """
    if jobs == 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(max_workers=jobs - 1) as executor:
        pending: deque[Future[Result]] = deque()
        try:
            for item in items:
                pending.append(executor.submit(work, item))
                if len(pending) > AHEAD:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            executor.shutdown(cancel_futures=True)
