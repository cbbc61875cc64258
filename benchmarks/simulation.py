"""Simulated real time: the scheduler alone, and how well a calibrated model predicts a replay."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.mapping import KITCHEN, pglog
from benchmarks.rows import Row
from proground_log.log.reader import LogReader
from proground_log.run.cost_model import CostModel
from proground_log.run.manifest import Manifest
from replay.plan import Plan
from replay.scheduler import Policy, Timing, schedule

FRAMES = 200_000
FRAME_NS = 33_333_333
TIMING = Timing(decode_ns=2_000_000, perceive_ns=90_000_000, insert_ns=3_000_000, step_ns=4_000_000)
OVERLOADED = Policy(50_000_000, 0, lock_step=False, queue=1, overrun="drop-oldest", beside=True)
SIMULATED = ("decode", "insert", "step")


def measure() -> list[Row]:
    """The scheduler under a load that drops frames, and the kitchen under a budget that fits."""
    arrivals_ns = range(0, FRAMES * FRAME_NS, FRAME_NS)
    start = time.perf_counter()
    mapped = sum(1 for _ in schedule(range(FRAMES), arrivals_ns, TIMING, OVERLOADED))
    seconds = time.perf_counter() - start
    rows = [
        Row("scheduler: frames simulated", FRAMES / seconds, "frames/s", least=100_000),
        Row("scheduler: frames of these that are mapped", 100 * mapped / FRAMES, "%"),
    ]
    return rows + (_prediction() if KITCHEN.is_dir() else [])


def _prediction() -> list[Row]:
    """This machine is calibrated before and after: what else it does changes by the minute."""
    with tempfile.TemporaryDirectory() as folder:
        before, after, log, run = (
            Path(folder, name) for name in ("before.json", "after.json", "log.mcap", "run")
        )
        pglog("record", "seven-scenes", str(KITCHEN), "-o", str(log))
        pglog("calibrate", "-o", str(before))
        # A robot has no telemetry, whose threads would take their part of the cores.
        budget = ["--budget-ms", "700", "--rate", "0", "--telemetry.no-enabled"]
        pglog("replay", str(log), "-o", str(run), "--stride", "2", *budget, "--cost", str(before))
        pglog("calibrate", "-o", str(after))
        manifest = Manifest.read(run / "manifest.json")
        timings = [
            Plan(LogReader(log), manifest.config, CostModel.load(str(path)), learns=False).timing
            for path in (before, after)
        ]
    result: Any = manifest.result
    machine = result["machine s"]
    frames, steps = result["frames mapped"], result["steps"]
    predicted_s = [
        (frames * (timing.decode_ns + timing.insert_ns) + steps * timing.step_ns) / 1e9
        for timing in timings
    ]
    taken_s = sum(machine[stage] for stage in SIMULATED)
    error = 100 * abs(sum(predicted_s) / 2 / taken_s - 1)
    ledger = 100 * machine["ledger"] / sum(machine.values())
    return [
        Row("kitchen: simulated time against this machine's own, off by", error, "%", most=15),
        Row("kitchen: ledger and its digests", ledger, "%", most=3),
    ]
