"""Opening logs and runs in the rerun viewer, and taking its picture without a screen."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from proground_log.telemetry.log_recording import write_log_recording

TELEMETRY_FILE = "telemetry.rrd"
LOCALHOST = "127.0.0.1"
START_TIMEOUT_S = 30.0
LOAD_TIMEOUT_S = 60.0
SETTLE_S = 1.5
"""Chunks and pictures are fetched and decoded in the background after a file is open."""


def view(paths: Sequence[Path], *, web: bool = False) -> None:
    """Open logs (.mcap) and runs (folders with a recording) in rerun; return when it is closed.

    Args:
        paths: what to open.
        web: serve the viewer to a browser on this machine instead of opening a window.

    Raises:
        ProgroundError: a path is neither, or rerun cannot be started.
    """
    with _recordings(paths) as recordings:
        # Its own port for pages is fixed: a second viewer would not start beside the first.
        mode = ["--web-viewer", "--web-viewer-port", "0"] if web else []
        command = _command(*mode, "--port", "auto", *map(str, recordings))
        try:
            result = subprocess.run(command, check=False)
        except KeyboardInterrupt:
            return
    if result.returncode:
        raise ProgroundError(
            f"the rerun viewer ended with code {result.returncode}",
            where=", ".join(map(str, paths)),
            todo="see its message above; without a screen, pass --web",
        )


def screenshot(
    paths: Sequence[Path],
    output_png: Path,
    size: tuple[int, int] = (1600, 1000),
    *,
    frame: int | None = None,
) -> list[str]:
    """Take a picture of the viewer, without a screen; needs a Vulkan driver.

    Args:
        paths: as for `view`.
        output_png: the picture.
        size: of the window in points; the picture may have more pixels than that.
        frame: where to put the cursor, or None to leave it where the file opens.

    Returns:
        What the views report as wrong. A view that has no data at all reports nothing.

    Raises:
        ProgroundError: a path is neither, or the viewer does not start.
    """
    port = _free_port()
    window = f"{size[0]}x{size[1]}"
    with _recordings(paths) as recordings:
        flags = ("--headless", "--hide-welcome-screen", "--port", str(port))
        command = _command(*flags, "--window-size", window)
        quiet = subprocess.DEVNULL
        # Messages would lie over the views for some seconds.
        environment = os.environ | {"RUST_LOG": "error"}
        with subprocess.Popen(
            command, stdout=quiet, stderr=quiet, start_new_session=True, env=environment
        ) as process:
            try:
                client = _connect(port, process)
                client.open([str(path) for path in recordings])
                _wait_until_loaded(client)
                if frame is not None:
                    client.set_time("frame", sequence=frame)
                time.sleep(SETTLE_S)
                output_png.write_bytes(client.take_screenshot())
                views = client.get_state().views
            except ConnectionError as error:
                # Without a driver it answers at first, and ends once it has to draw.
                raise _not_started() from error
            finally:
                # The command is a wrapper round the viewer: both have to go.
                os.killpg(process.pid, signal.SIGKILL)
    return [f"{view.name}: {report.summary}" for view in views for report in view.reports]


def _command(*arguments: str) -> list[str]:
    # `python -m rerun` is the viewer of this very environment, whatever PATH says. Without --bind
    # it would listen on all interfaces.
    return [sys.executable, "-m", "rerun", "--bind", LOCALHOST, *arguments]


@contextmanager
def _recordings(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """The .rrd files that show the paths; those made of logs are removed afterwards.

    Rerun opens an .mcap file too, but then ignores a blueprint that comes with it.
    """
    with tempfile.TemporaryDirectory(prefix="pglog-view-") as folder:
        yield [
            _convert(path, Path(folder, f"{number}.rrd"))
            if path.suffix == ".mcap"
            else _telemetry_of(path)
            for number, path in enumerate(paths)
        ]


def _telemetry_of(path: Path) -> Path:
    if path.is_dir():
        recording = path / TELEMETRY_FILE
        if recording.is_file():
            return recording
        raise ProgroundError(
            f"the folder has no {TELEMETRY_FILE}",
            where=path,
            todo="give the folder of a run that was replayed with telemetry",
        )
    if require_file(path).suffix == ".rrd":
        return path
    raise ProgroundError(
        "neither a log nor a run", where=path, todo="give an .mcap file or the folder of a run"
    )


def _convert(log: Path, recording: Path) -> Path:
    write_log_recording(log, recording)
    return recording


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOCALHOST, 0))
        return int(probe.getsockname()[1])


def _connect(port: int, process: subprocess.Popen[bytes]) -> ViewerClient:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            client = ViewerClient.connect(f"rerun+http://{LOCALHOST}:{port}/proxy")
            client.get_state()
            return client
        except (RuntimeError, ConnectionError):
            time.sleep(0.2)
    raise _not_started()


def _not_started() -> ProgroundError:
    return ProgroundError(
        "the headless rerun viewer did not start",
        where="rerun --headless",
        todo="install a Vulkan driver (Debian: mesa-vulkan-drivers libvulkan1)",
    )


def _wait_until_loaded(client: ViewerClient) -> None:
    deadline = time.monotonic() + LOAD_TIMEOUT_S
    while client.get_state().loading and time.monotonic() < deadline:
        time.sleep(0.1)
