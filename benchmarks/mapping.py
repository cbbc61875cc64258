"""Quality, cost of telemetry and memory of whole replays of the real recordings."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.query import MESH_VOXEL_M
from benchmarks.rows import SHARED_DATA, Row, median_seconds
from proground_log.mapping.map_file import load_map
from proground_log.query.mesh import extract_mesh
from proground_log.run.folder import RunFolder

KITCHEN = SHARED_DATA / "7scenes_redkitchen" / "seq-01"
HOUSE = SHARED_DATA / "aws_small_house_labelled"
PROTOCOL = ["--hold-out-every", "10", "--steps", "10", "--mapper.sampling.rays", "1024"]


def pglog(*arguments: str) -> str:
    """Run a command as a user would and return what it printed."""
    command = [sys.executable, "-m", "pglog", *arguments]
    result = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return result.stdout


def measure_kitchen() -> list[Row]:
    """The kitchen: every second frame mapped, every tenth of those held out."""
    return _quality("kitchen", "seven-scenes", KITCHEN, ["--stride", "2"], psnr_db=20, l1_cm=4)


def measure_house() -> list[Row]:
    """The labelled house: every frame, every tenth held out."""
    return _quality("house", "replica", HOUSE, [], psnr_db=25, l1_cm=3)


def _quality(
    name: str, format_name: str, source: Path, flags: list[str], *, psnr_db: float, l1_cm: float
) -> list[Row]:
    if not source.is_dir():
        return []
    with tempfile.TemporaryDirectory() as folder:
        log, run = Path(folder, "log.mcap"), Path(folder, "run")
        pglog("record", format_name, str(source), "-o", str(log))
        pglog("replay", str(log), "-o", str(run), *PROTOCOL, *flags)
        scores = json.loads(pglog("evaluate", str(run), "--json"))["scores"]
        result = _result(run)
        content = load_map(RunFolder(run).map)
        (mesh_s,) = median_seconds(lambda: extract_mesh(content, MESH_VOXEL_M), rounds=1)
    seconds = result["machine s"]
    sinks_s = sum(seconds[stage] for stage in ("views", "telemetry", "ledger"))
    mapping_s, total_s = seconds["insert"] + seconds["step"], sum(seconds.values())
    rows = [
        Row(f"{name}: colour PSNR on held-out views", scores["psnr_db"], "dB", least=psnr_db),
        Row(f"{name}: colour SSIM on held-out views", scores["ssim"], ""),
        Row(f"{name}: depth L1 on held-out views", scores["depth_l1_cm"], "cm", most=l1_cm),
        Row(f"{name}: depth that the map misses", scores["missed_percent"], "%"),
        Row(f"{name}: map", scores["map_mb"], "MB"),
        Row(f"{name}: mesh of {100 * MESH_VOXEL_M:.0f} cm", mesh_s, "s", most=20),
        Row(
            f"{name}: mapping, a frame",
            1e3 * mapping_s / result["frames mapped"],
            "ms",
        ),
        Row(f"{name}: telemetry and ledger", 100 * sinks_s / total_s, "%", most=10),
        Row(f"{name}: peak memory", result["peak memory MB"], "MB", most=2000),
    ]
    for key, unit in (("accuracy_cm", "cm"), ("completion_cm", "cm"), ("completion_percent", "%")):
        if key in scores:
            rows.append(Row(f"{name}: mesh {key.rpartition('_')[0]}", scores[key], unit))
    return rows


def measure_memory() -> list[Row]:
    """Peak memory of a short and a long replay of the same log."""
    if not KITCHEN.is_dir():
        return []
    peaks_mb = []
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder, "log.mcap")
        pglog("record", "seven-scenes", str(KITCHEN), "-o", str(log))
        for frames in (40, 250):
            run = Path(folder, f"run{frames}")
            flags = ["--max-frames", str(frames), "--steps", "1"]
            pglog("replay", str(log), "-o", str(run), *flags)
            peaks_mb.append(float(_result(run)["peak memory MB"]))
    short_mb, long_mb = peaks_mb
    return [
        Row("peak memory of 40 frames", short_mb, "MB"),
        Row("peak memory of 250 frames", long_mb, "MB", most=2000),
        Row("peak memory, 250 frames / 40 frames", long_mb / short_mb, "x"),
    ]


def _result(run: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((run / "manifest.json").read_text())["result"]
    return result
