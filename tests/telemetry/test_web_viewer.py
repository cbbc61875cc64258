"""The viewer in a browser: what is served, to whom, and what the browser makes of it."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, Queue
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import aiohttp
import cv2
import numpy as np
import pytest

from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from tests.telemetry import telemetry_stream as stream

pytestmark = pytest.mark.slow

BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
START_TIMEOUT_S, DRAWN_WITHIN_S = 60, 120
"""Without a graphics card, a browser takes seconds for every picture of the viewer."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's recording, of three frames."""
    folder = tmp_path_factory.mktemp("run")
    sink = TelemetrySink(folder / "telemetry.rrd", recording_id="run")
    for event in stream.of_frames(range(3), None):
        sink.on_event(event)
    sink.on_event(stream.FINISHED)
    sink.close()
    merge_segments([folder / "telemetry.rrd"], folder / "telemetry.rrd")
    return folder


@contextmanager
def served(run: Path) -> Iterator[str]:
    """`pglog view RUN --web`, without a browser of its own; its address."""
    command = [sys.executable, "-m", "pglog", "view", str(run), "--web"]
    # Nothing that could open a window is on this path.
    environment = os.environ | {"PATH": "", "BROWSER": "true", "RUST_LOG": "info"}
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
        start_new_session=True,
    )
    lines: Queue[str] = Queue()
    assert process.stdout is not None
    output = process.stdout
    threading.Thread(target=lambda: [lines.put(line) for line in output], daemon=True).start()
    try:
        told = ""
        address = None
        with suppress(Empty):
            while address is None:
                told += lines.get(timeout=START_TIMEOUT_S)
                address = re.search(r"http://127\.0\.0\.1:\d+/?\?url=\S+", told)
        assert address is not None, told
        yield address[0]
    finally:
        # The command runs the viewer, which is a wrapper round another: all have to go.
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def ports_of(address: str) -> tuple[int, int]:
    """Where the page is, and where it fetches the recording."""
    page = urlsplit(address)
    source = urlsplit(parse_qs(page.query)["url"][0].removeprefix("rerun+"))
    assert page.port is not None
    assert source.port is not None
    return page.port, source.port


def listening() -> set[tuple[str, int]]:
    """Addresses, hexadecimal, and ports of this machine that something listens at."""
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path("/proc/net", table).read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            if state == "0A":
                host, port = local.split(":")
                found.add((host, int(port, 16)))
    return found


@pytest.mark.skipif(not Path("/proc/net/tcp").is_file(), reason="tells who listens on Linux alone")
def test_page_viewer_and_recording_are_served_to_this_machine_alone(run: Path) -> None:
    with served(run) as address:
        ports = ports_of(address)
        hosts = {host for host, port in listening() if port in ports}
        assert hosts == {"0100007F"}
        page = urlopen(address).read().decode()
        assert "<canvas" in page
        root = address.split("?")[0].rstrip("/")
        assert urlopen(f"{root}/re_viewer_bg.wasm").read(4) == b"\0asm"
        assert b"function" in urlopen(f"{root}/re_viewer.js").read()
        with socket.create_connection(("127.0.0.1", ports[1]), timeout=5):
            pass


def test_two_runs_are_served_side_by_side(run: Path) -> None:
    with served(run) as first, served(run) as second:
        ports = {*ports_of(first), *ports_of(second)}
        assert len(ports) == 4
        for address in (first, second):
            assert "<canvas" in urlopen(address).read().decode()


@contextmanager
def browsing(address: str, profile: Path) -> Iterator[str]:
    """A browser without a screen that has the page open; where its DevTools listen."""
    flags = ("--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0")
    software = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    size = ("--window-size=1000,700", f"--user-data-dir={profile}")
    with subprocess.Popen(
        [str(BROWSER), *flags, *software, *size, address],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            told = profile / "DevToolsActivePort"
            deadline = time.monotonic() + START_TIMEOUT_S
            while not (told.is_file() and told.read_text().count("\n")):
                assert time.monotonic() < deadline, "the browser did not start"
                time.sleep(0.2)
            yield f"http://127.0.0.1:{told.read_text().splitlines()[0]}"
        finally:
            os.killpg(process.pid, signal.SIGKILL)


async def colourful(devtools: str, cells: list[tuple[slice, slice]], least: float) -> list[float]:
    """Share of colourful pixels in each cell of the page, once all have so many, or time is up."""
    shares = [0.0]
    deadline = time.monotonic() + DRAWN_WITHIN_S
    async with aiohttp.ClientSession() as session:
        async with session.get(f"{devtools}/json/list") as answer:
            pages = [target for target in await answer.json() if target["type"] == "page"]
        async with session.ws_connect(pages[0]["webSocketDebuggerUrl"], max_msg_size=0) as page:
            while min(shares) < least and time.monotonic() < deadline:
                await page.send_json({"id": 1, "method": "Page.captureScreenshot"})
                encoded = np.frombuffer(
                    b64decode((await page.receive_json())["result"]["data"]), np.uint8
                )
                image = cv2.cvtColor(cv2.imdecode(encoded, cv2.IMREAD_COLOR), cv2.COLOR_BGR2HSV)
                shares = [
                    float(((image[cell][..., 1] > 90) & (image[cell][..., 2] > 60)).mean())
                    for cell in cells
                ]
                await asyncio.sleep(1)
    return shares


@pytest.mark.skipif(BROWSER is None, reason="no browser (Debian: chromium)")
def test_a_browser_shows_the_run(run: Path, tmp_path: Path) -> None:
    # An empty view is grey: the map is on the left, the rendered views are on the right.
    cells = [np.s_[100:400, 20:440], np.s_[100:400, 470:980]]
    with served(run) as address, browsing(address, tmp_path / "profile") as devtools:
        assert min(asyncio.run(colourful(devtools, cells, 0.05))) >= 0.05
