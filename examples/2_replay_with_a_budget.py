"""Replay the log as on a computer with little time for each frame, and read the losses.

python examples/2_replay_with_a_budget.py ROOM [BUDGET_MS]
"""

import sys
from pathlib import Path

import numpy as np

import proground_log as pg
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.perception.task import Task
from proground_log.run.settings import ReplayConfig, SimulationConfig, TelemetryConfig
from replay.session import replay

folder = Path(sys.argv[1])
budget_ms = float(sys.argv[2]) if len(sys.argv) > 2 else 1000.0
log = pg.open_log(folder / "room.mcap")
task = Task("furniture", ("sofa", "bed", "table", "chair"))
detector = SimulatedPerception(task, log.label_names, log.calibration.color, seed=0)
config = ReplayConfig(
    simulation=SimulationConfig(budget_ms=budget_ms, rate=0),
    telemetry=TelemetryConfig(enabled=False),
)
replay(log.path, folder / "run", config, perceiver=detector, overwrite=True)

run = pg.open_run(folder / "run")
print(run.manifest.result)
for term in ("rgb", "depth", "semantic"):
    first, last = np.nanmean(run.losses[term][:20]), np.nanmean(run.losses[term][-20:])
    print(f"{term}: {first:.3f}, and {last:.3f} after {len(run.losses['step'])} steps")
idle_ns = sum(entry["idle_ns"] for entry in run.events("scheduled"))
print(f"the mapper had nothing to do for {idle_ns / 1e9:.2f} simulated seconds")
