"""Reference ledgers of the built-in room; `python -m tests.replay.golden` writes them anew.

Each is bit-exact on the kind of machine that it was made on, and close elsewhere. Writing them says
what has changed in each.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from proground_log.field.config import FieldConfig
from proground_log.frame import Selection
from proground_log.log.reader import LogReader
from proground_log.mapping.neural.config import BufferConfig, NeuralConfig, SamplingConfig
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.of_log import task_of_labels
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.manifest import PACKAGES
from proground_log.run.settings import ReplayConfig, SimulationConfig, TelemetryConfig
from recorders.record import record
from recorders.room import RoomSource
from replay.divergence.table import difference_table
from replay.session import replay

ROOM_FRAMES = 12
GOLDEN = Path(__file__).parent / "golden"
COST = str(GOLDEN / "cost_model.json")
"""Costs of round numbers: about 20 ms a step of `SMALL`, frames that come every 100 ms."""

SMALL = ReplayConfig(
    steps=3,
    hold_out_every=5,
    digest_every=4,
    checkpoint_every=4,
    simulation=SimulationConfig(cost=COST),
    mapper=NeuralConfig(
        field=FieldConfig(log2_rows=12, levels=8, voxel_m=0.05),
        sampling=SamplingConfig(rays=128, uniform=10, near_surface=7),
        buffer=BufferConfig(capacity=3000, keyframe_samples=900),
    ),
    telemetry=TelemetryConfig(view_every=4, view_width=40, mesh_every=8, mesh_voxel_m=0.15),
)


def under(**simulation: Any) -> ReplayConfig:
    """`SMALL` on another computer."""
    return replace(SMALL, simulation=replace(SMALL.simulation, **simulation))


CASES = {
    "room": SMALL,
    "drop_oldest": under(budget_ms=60, rate=3.0),
    "drop_newest": under(budget_ms=60, rate=3.0, queue=2, overrun="drop-newest"),
    "wait": under(budget_ms=40, rate=4.0, overrun="wait"),
    "perceived": under(budget_ms=150, rate=0.8),
    "perceived_beside": under(budget_ms=60, rate=1.5, perceive_beside=True),
}
"""What is replayed; cases called "perceived" see with the simulated detector."""


def perceiver_of(log: Path, *, cushions: bool = True) -> SimulatedPerception:
    """The simulated detector for all classes of a log, with or without cushions."""
    reader = LogReader(log)
    task = task_of_labels(reader, BuiltinTexts().knows)
    if not cushions:
        task = replace(task, prompts=tuple(p for p in task.prompts if p != "cushion"))
    return SimulatedPerception(task, reader.label_names, reader.calibration.color, 0)


def replay_case(name: str, log: Path, run: Path) -> list[dict[str, Any]]:
    """Replay one of `CASES`; returns its ledger."""
    config = replace(CASES[name], telemetry=TelemetryConfig(enabled=False))
    perceiver = perceiver_of(log) if name.startswith("perceived") else None
    replay(log, run, config, perceiver=perceiver)
    return list(read_ledger(RunFolder(run).ledger))


def golden_path(name: str) -> Path:
    """Where the ledger of a case is kept."""
    return GOLDEN / f"{name}.json"


def machine() -> dict[str, str]:
    """What the bits of a result depend on."""
    versions = {name: version(name) for name in PACKAGES}
    return {"capability": torch.backends.cpu.get_cpu_capability(), **versions}


def record_room(output: Path) -> Path:
    """The log that the golden ledgers, and many tests, replay."""
    source = RoomSource(seed=0, frames=ROOM_FRAMES)
    record(
        source,
        "synthetic",
        output,
        Selection(),
        overwrite=False,
        progress=lambda *_: None,
    )
    return output


def write(name: str, ledger: list[dict[str, Any]]) -> None:
    """Keep a ledger, and say what is new in it."""
    path = golden_path(name)
    before = json.loads(path.read_text())["ledger"] if path.is_file() else []
    lines = ",\n".join(json.dumps(entry) for entry in ledger)
    path.write_text(f'{{"machine": {json.dumps(machine())},\n"ledger": [\n{lines}\n]}}\n')
    changes = difference_table(before, ledger)
    print(f"{name}: {'new' if not before else f'{len(changes)} changes'}")
    for row in changes if before else ():
        distance = "" if row.ulp is None else f", up to {row.ulp} ulp"
        where = f"from frame {row.frame}, step {row.step}"
        print(f"  {row.cause}: {row.name}, {row.lines} lines {where}{distance}")


def main() -> None:
    """Replay every case and keep its ledger."""
    with tempfile.TemporaryDirectory() as folder:
        log = record_room(Path(folder, "room.mcap"))
        for name in CASES:
            write(name, replay_case(name, log, Path(folder, name)))


if __name__ == "__main__":
    main()
