"""The engine of a sweep on a ray cluster: a task a cell, tried again when its node is lost."""

from __future__ import annotations

import logging
import os
import secrets
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from proground_log.errors import ProgroundError
from proground_log.files import disk_errors, file_sha256, written_whole
from proground_log.run.folder import RunFolder
from proground_log.run.manifest import Manifest
from proground_log.version import __version__
from replay.device import set_threads
from replay.sweep.cells import Job, attempt, require_workers

try:
    # Ray tells its makers about its use unless told not to; nothing here goes online.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray
except ImportError as error:
    raise ProgroundError(
        "ray is not installed",
        where="--engine ray",
        todo="install it with `pip install proground-log[ray]`, or use --engine local",
    ) from error

RETRIES = 3
"""Times that a cell is begun again after its worker or node was lost."""

REACH_S = 10.0
"""Time in which a cluster answers."""

Files = dict[str, bytes]


class RayEngine:
    """Computes cells on the nodes of a cluster; see `open_ray`.

    A node that sees the sweep's folder works in it. To any other one, what there is of a cell
    travels there and back; so does the log, where a node does not have it under its path.

    Args:
        log_path: the log of all jobs.
        token: a file in the sweep's folder, by which a node sees that the folder is the same.
        places: cells at once.
        ships_log: whether there may be nodes that do not have the log.
    """

    def __init__(self, log_path: Path, token: Path, places: int, *, ships_log: bool) -> None:
        self.places = places
        self._token = token
        self._log_sha256 = file_sha256(log_path)
        # In a list, a reference stays one: only nodes that need the copy fetch it.
        self._copies = [ray.put(log_path.read_bytes())] if ships_log else []
        self._flag = ray.remote(num_cpus=0)(_Flag).remote()
        # A process is not used twice, as with the local engine.
        self._task = ray.remote(num_cpus=1, max_calls=1, max_retries=RETRIES)(_on_node)

    def run(self, job: Job) -> str | None:
        """Do a job; returns why it failed, or None."""
        task = self._task.remote(
            job,
            __version__,
            self._log_sha256,
            self._copies,
            self._token,
            _pack(job.folder),
            self._flag,
        )
        try:
            error, files = ray.get(task)
        except ray.exceptions.RayError as lost:
            return f"{job.folder}: lost on the cluster ({str(lost).strip().splitlines()[0]})"
        _unpack(files, job.folder)
        manifest = RunFolder(job.folder).manifest
        if manifest.is_file():
            # A copy of the log is gone by now; the run is of the log itself.
            made = replace(Manifest.read(manifest), log_path=str(job.log_path.resolve()))
            made.write(manifest)
        return error

    def stop(self) -> None:
        """Let all jobs stop after the frame at hand."""
        ray.get(self._flag.hoist.remote())


@contextmanager
def open_ray(
    log_path: Path, output: Path, workers: int | None = None, address: str | None = None
) -> Iterator[RayEngine]:
    """Connect to a cluster, or start one on this computer.

    Args:
        log_path: the log of all jobs.
        output: folder of the sweep.
        workers: cells at once; None: one a core of the cluster.
        address: of the cluster, as `ray start` prints it; None: start one here.

    Raises:
        ProgroundError: there is no cluster at the address, or it does not let us in.
    """
    require_workers(workers)
    if address is not None:
        _require_reachable(address)
    token = output / f".sweep-{secrets.token_hex(8)}"
    with disk_errors(output):
        output.mkdir(parents=True, exist_ok=True)
        token.touch()
    try:
        try:
            ray.init(
                address or "local",
                num_cpus=workers if address is None else None,
                include_dashboard=False if address is None else None,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        except (ConnectionError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
            raise ProgroundError(
                f"the ray cluster does not let us in ({str(error).strip().splitlines()[0]})",
                where="--engine ray" if address is None else f"--ray-address {address}",
                todo="check its version of ray and its token, see docs/sweep.md",
            ) from error
        places = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        yield RayEngine(log_path, token, places, ships_log=address is not None)
    finally:
        ray.shutdown()
        token.unlink()


def _require_reachable(address: str) -> None:
    """Raise a ProgroundError where nobody listens; ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=REACH_S).close()
    except (OSError, OverflowError, ValueError) as error:
        raise ProgroundError(
            f"no ray cluster answers there ({error})",
            where=f"--ray-address {address}",
            todo="give HOST:PORT of `ray start --head`, or leave it out to start one here",
        ) from error


class _Flag:
    """An actor that knows whether the sweep shall stop."""

    def __init__(self) -> None:
        self._is_up = False

    def hoist(self) -> None:
        self._is_up = True

    def is_up(self) -> bool:
        return self._is_up


def _on_node(
    job: Job,
    version: str,
    log_sha256: str,
    copies: Sequence[Any],
    token: Path,
    begun: Files,
    flag: Any,
) -> tuple[str | None, Files]:
    """Do a job on a node: why it failed, or None; and the cell's files, where the sweep's folder
    is not to be seen from here."""
    if version != __version__:
        return f"a node has proground-log {__version__}, this computer {version}", {}
    set_threads(1)

    def is_stopping() -> bool:
        return bool(ray.get(flag.is_up.remote()))

    with TemporaryDirectory(prefix="pglog-sweep-") as scratch:
        log_path = job.log_path
        if not (log_path.is_file() and file_sha256(log_path) == log_sha256):
            if not copies:
                return f"{log_path}: the log is gone or has changed", {}
            log_path = Path(scratch, log_path.name)
            log_path.write_bytes(ray.get(copies[0]))
        if token.exists():
            return attempt(replace(job, log_path=log_path), is_stopping), {}
        folder = Path(scratch, "cells", job.folder.name)
        _unpack(begun, folder)
        error = attempt(replace(job, log_path=log_path, folder=folder), is_stopping)
        return error, _pack(folder)


def _pack(folder: Path) -> Files:
    """Every file of a folder, by its path there."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def _unpack(files: Files, folder: Path) -> None:
    """Put files into a folder."""
    for name, content in files.items():
        with written_whole(folder / name) as temporary:
            temporary.write_bytes(content)
