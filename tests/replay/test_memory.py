"""The memory of a replay does not grow with the length of the log."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Calibration, Camera
from proground_log.frame import Selection, SensorFrame
from proground_log.run.folder import RunFolder
from proground_log.streams import stream
from recorders.record import record
from tests.replay.small_replay import SMALL_FLAGS

CAMERA = Camera(160, 120, 120.0, 120.0, 80.0, 60.0)
ALLOWED_MB = 40
"""For the buffer, which fills up to its cap, and the allocator's moods; the long log is 17 MB."""


@dataclass
class Wall:
    """A camera that looks at a rough wall from ever new places; an endless source."""

    name: str = "wall"
    calibration: Calibration = field(default_factory=lambda: Calibration.registered(CAMERA))
    label_names: dict[int, str] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return 10**6

    def frame(self, index: int) -> SensorFrame:
        random = stream(0, "wall", index)
        color = random.integers(0, 256, (120, 160, 3), dtype=np.uint8)
        depth = (2000 + random.integers(-200, 200, (120, 160))).astype(np.uint16)
        pose = np.eye(4)
        pose[0, 3] = np.sin(index / 50)
        jpeg = cv2.imencode(".jpg", color)[1].tobytes()
        return SensorFrame(index, index * 10**8, index * 10**8, jpeg, "jpeg", depth, pose)

    def ground_truth_mesh(self) -> None:
        return None


def peak_memory_mb(log: Path, run: Path) -> float:
    command = [sys.executable, "-m", "pglog", "replay", str(log), "-o", str(run)]
    flags = [*SMALL_FLAGS, "--steps", "1"]
    subprocess.run([*command, *flags], check=True, capture_output=True)
    result = json.loads(RunFolder(run).manifest.read_text())["result"]
    return float(result["peak memory MB"])


@pytest.mark.slow
def test_peak_memory_is_flat_in_the_length_of_the_log(tmp_path: Path) -> None:
    peaks_mb = []
    for frames in (20, 220):
        log = tmp_path / f"{frames}.mcap"
        selection = Selection(stop=frames)
        record(Wall(), "wall", log, selection, overwrite=False, progress=lambda *_: None)
        peaks_mb.append(peak_memory_mb(log, tmp_path / f"run{frames}"))
    short_mb, long_mb = peaks_mb
    assert long_mb < short_mb + ALLOWED_MB
