"""Writes the golden ledger of the built-in room anew: python -m tests.replay.golden."""

from __future__ import annotations

import json
import tempfile
from importlib.metadata import version
from pathlib import Path

import torch

from proground_log.frame import Selection
from recorders.record import record
from recorders.room import RoomSource
from replay.ledger import read_ledger
from replay.manifest import PACKAGES
from replay.run_folder import RunFolder
from replay.session import replay

ROOM_FRAMES = 12


def machine() -> dict[str, str]:
    """What the bits of a result depend on."""
    versions = {name: version(name) for name in PACKAGES}
    return {"capability": torch.backends.cpu.get_cpu_capability(), **versions}


def record_room(output: Path) -> Path:
    """The log that the golden ledger, and many tests, replay."""
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


def main() -> None:
    """Replay the room and keep its ledger."""
    from tests.replay.test_determinism import GOLDEN, SMALL

    with tempfile.TemporaryDirectory() as folder:
        log, run = record_room(Path(folder, "room.mcap")), Path(folder, "run")
        replay(log, run, SMALL)
        ledger = list(read_ledger(RunFolder(run).ledger))
    GOLDEN.mkdir(exist_ok=True)
    lines = ",\n".join(json.dumps(entry) for entry in ledger)
    machine_text = json.dumps(machine())
    text = f'{{"machine": {machine_text},\n"ledger": [\n{lines}\n]}}\n'
    (GOLDEN / "room.json").write_text(text)


if __name__ == "__main__":
    main()
