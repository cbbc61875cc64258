"""Runs a target on many inputs, in a child process that may not live through it."""

from __future__ import annotations

import faulthandler
import mmap
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from shutil import copyfile

import numpy as np

from proground_log.errors import ProgroundError
from tests.fuzz.containers import OUTSIDE
from tests.fuzz.targets import TARGETS, Target

LONGEST_S = 10
"""For one input; they are a few kilobytes."""
ROOM_BYTES = 512 * 2**20
"""Address space beyond what the valid inputs took."""
MOST_GROWTH_KB = 256 * 2**10
"""Memory in use beyond that."""
MOST_FINDINGS = 5
"""Of one target: after as many, it is given up."""


@dataclass(frozen=True)
class Finding:
    """What should not have happened.

    Args:
        number: of the input; 0 is a valid one.
        what: the traceback, or the signal.
        saved: a copy of the file that led to it.
    """

    number: int
    what: str
    saved: Path


@dataclass
class Tally:
    """What became of a target's inputs.

    Args:
        results: inputs that were read, changed as they were.
        errors: inputs that were refused.
        seconds: in all.
        slowest_s: the longest of one input.
        growth_kb: memory in use beyond what the valid inputs took, at most.
    """

    results: int
    errors: int
    seconds: float
    slowest_s: float
    growth_kb: int
    findings: list[Finding]


_COUNTS = np.dtype(
    [(name, np.int64) for name in ("number", "results", "errors", "slowest_us", "growth_kb")]
)
"""What a child leaves behind, whatever happens to it; `number` is of the input at hand."""


def run(
    name: str, *, seed: int, inputs: int | None, seconds: float, findings_folder: Path
) -> Tally:
    """Read inputs until there were so many, or for so long.

    Input `number` depends on the target, the seed and the number alone.
    """
    counts: np.void = np.frombuffer(mmap.mmap(-1, mmap.PAGESIZE), _COUNTS, 1)[0]
    start, findings, number = time.monotonic(), list[Finding](), 0
    while len(findings) < MOST_FINDINGS:
        with tempfile.TemporaryDirectory(prefix="pglog-fuzz-") as folder:
            root = Path(folder)
            (root / "out").mkdir()
            child = os.fork()
            if child == 0:
                _child(
                    name, root, seed, range(number, inputs or sys.maxsize), start + seconds, counts
                )
            _, status, _ = os.wait4(child, 0)
            if status == 0:
                break
            number = int(counts["number"])
            findings.append(_finding(name, root, seed, number, status, findings_folder))
            number += 1
        # A valid input that cannot be read makes all that follows worthless.
        if number == 1:
            break
    seconds = time.monotonic() - start
    return Tally(
        int(counts["results"]),
        int(counts["errors"]),
        seconds,
        counts["slowest_us"] / 1e6,
        int(counts["growth_kb"]),
        findings,
    )


def _finding(
    name: str, root: Path, seed: int, number: int, status: int, findings_folder: Path
) -> Finding:
    what = (root / "stderr").read_text(errors="replace").strip()
    if os.WIFSIGNALED(status):
        what += f"\nkilled by {signal.Signals(os.WTERMSIG(status)).name}"
    changed = root / "changed"
    at = Path(changed.read_text()) if changed.exists() else root / "stderr"
    saved = findings_folder / f"{name}-{seed}-{number}{at.suffix}"
    findings_folder.mkdir(parents=True, exist_ok=True)
    copyfile(at, saved)
    return Finding(number, what, saved)


def _child(name: str, root: Path, seed: int, numbers: range, until: float, counts: np.void) -> None:
    """Never returns."""
    status = 1
    try:
        errors = os.open(root / "stderr", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(errors, 1)
        os.dup2(errors, 2)
        faulthandler.enable(errors)
        tempfile.tempdir = str(root)
        here = root / "here"
        here.mkdir()
        os.chdir(here)
        _read_all(TARGETS[name], zlib.crc32(name.encode()), root, seed, numbers, until, counts)
        status = 0
    except BaseException:
        os.write(errors, traceback.format_exc().encode(errors="replace"))
    finally:
        os._exit(status)


def _read_all(
    target: Target,
    target_seed: int,
    root: Path,
    seed: int,
    numbers: range,
    until: float,
    counts: np.void,
) -> None:
    sources = []
    for place, write in enumerate(target.inputs):
        (root / f"in{place}").mkdir()
        sources.append(write(root / f"in{place}"))
    for source in sources:
        _guarded(target, source, root, counts, is_valid=True)
    resource.setrlimit(resource.RLIMIT_AS, (_size_bytes() + ROOM_BYTES,) * 2)
    before_kb = _in_use_kb()
    for number in numbers:
        if time.monotonic() > until:
            return
        counts["number"] = number
        if number == 0:
            continue
        rng = np.random.default_rng([seed, target_seed, number])
        place = int(rng.integers(len(sources)))
        victims = [
            (path, mutators)
            for pattern, mutators in target.changed.items()
            for path in sorted((root / f"in{place}").rglob(pattern))
        ]
        path, mutators = victims[rng.integers(len(victims))]
        valid = path.read_bytes()
        path.write_bytes(mutators[rng.integers(len(mutators))](valid, rng))
        (root / "changed").write_text(str(path))
        began = time.monotonic()
        _guarded(target, sources[place], root, counts)
        took_us = int(1e6 * (time.monotonic() - began))
        counts["slowest_us"] = max(counts["slowest_us"], took_us)
        growth_kb = _in_use_kb() - before_kb
        counts["growth_kb"] = growth_kb
        assert growth_kb < MOST_GROWTH_KB, f"{growth_kb} KiB of memory in use"
        path.write_bytes(valid)


def _guarded(
    target: Target, source: Path, root: Path, counts: np.void, *, is_valid: bool = False
) -> None:
    """Read one input; raises whatever is wrong about that."""
    before = set(_surroundings(root))
    faulthandler.dump_traceback_later(LONGEST_S, exit=True)
    try:
        target.read(source, root / "out")
        counts["results"] += not is_valid
    except ProgroundError as error:
        if is_valid or (_ran_out_of_memory(error) and not target.asks_freely):
            raise
        counts["errors"] += 1
    faulthandler.cancel_dump_traceback_later()
    for path in (root / "out").iterdir():
        path.unlink()
    written = sorted(set(_surroundings(root)) ^ before)
    assert not written, f"something was written: {written}"


def _ran_out_of_memory(error: BaseException | None) -> bool:
    """Whether an error is the polite form of one on memory."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False


def _surroundings(root: Path) -> Iterator[tuple[str, int, int]]:
    """Everything around that could have been written, but for the folder that is for output."""
    if OUTSIDE.exists():
        yield str(OUTSIDE), 0, 0
    for folder, folders, files in os.walk(root):
        if folder == str(root):
            folders.remove("out")
        for name in files:
            if name == "stderr":
                continue
            found = Path(folder, name).stat()
            yield f"{folder}/{name}", found.st_size, found.st_mtime_ns
        yield from ((f"{folder}/{name}", 0, 0) for name in folders)


def _size_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE


def _in_use_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
