"""A run on disk: the finished files, and what an unfinished run keeps to go on."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from proground_log.errors import ProgroundError
from proground_log.files import disk_errors, written_whole
from proground_log.run.manifest import Manifest


@dataclass(frozen=True)
class RunFolder:
    """Paths of a run; files under these names are whole, `.partial` ones are being written."""

    path: Path

    @property
    def manifest(self) -> Path:
        return self.path / "manifest.json"

    @property
    def ledger(self) -> Path:
        return self.path / "ledger.jsonl"

    @property
    def map(self) -> Path:
        return self.path / "map.safetensors"

    @property
    def telemetry(self) -> Path:
        return self.path / "telemetry.rrd"

    @property
    def evaluation(self) -> Path:
        """How good its map was found to be, the last time that somebody judged it."""
        return self.path / "evaluation.json"

    @property
    def checkpoint(self) -> Path:
        return self.path / "checkpoint.safetensors"

    @property
    def checkpoints(self) -> Path:
        """Folder of those that were kept."""
        return self.path / "checkpoints"

    def keep_checkpoint(self, frames: int) -> None:
        """Keep the newest checkpoint, taken after so many frames were read."""
        kept = self.checkpoints / f"frame_{frames:06}.safetensors"
        with disk_errors(kept):
            self.checkpoints.mkdir(exist_ok=True)
            kept.unlink(missing_ok=True)
            # A checkpoint is never written to, so that both names may mean the same bytes.
            kept.hardlink_to(self.checkpoint)

    def kept_checkpoints(self) -> dict[int, Path]:
        """All of them by the number of frames read."""
        files = sorted(self.checkpoints.glob("frame_*.safetensors"))
        return {int(file.stem.removeprefix("frame_")): file for file in files}

    @property
    def partial_ledger(self) -> Path:
        return self.path / "ledger.jsonl.partial"

    def telemetry_segments(self) -> list[Path]:
        """Telemetry of an unfinished run, one file for each time it was started."""
        return sorted(self.path.glob("telemetry.*.rrd.partial"))

    def next_telemetry_segment(self) -> Path:
        """Name for the telemetry from now on."""
        return self.path / f"telemetry.{len(self.telemetry_segments()):03}.rrd.partial"

    def forget_progress(self) -> None:
        """Remove what only an unfinished run needs."""
        for file in (*self.telemetry_segments(), self.checkpoint):
            file.unlink(missing_ok=True)

    @property
    def is_finished(self) -> bool:
        """Whether the replay came to its end."""
        return self.map.is_file()

    def require_finished(self) -> RunFolder:
        """Return self; raise a ProgroundError unless this is the folder of a finished run."""
        if not self.path.is_dir():
            raise ProgroundError("no such run", where=self.path, todo="check the path")
        if not self.is_finished:
            todo = "make one with `pglog replay LOG -o RUN`"
            if self.manifest.is_file():
                log = Manifest.read(self.manifest).log_path
                todo = f"finish it with `pglog replay {log} -o {self.path} --resume`"
            raise ProgroundError("is not a finished run", where=self.path, todo=todo)
        return self

    def clear(self) -> None:
        """Remove every file of a run, finished or not."""
        known = [self.manifest, self.ledger, self.map, self.telemetry, self.evaluation]
        known += [self.checkpoint, self.partial_ledger]
        kept = self.kept_checkpoints().values()
        for file in [*known, *self.telemetry_segments(), *kept]:
            file.unlink(missing_ok=True)
        if self.checkpoints.is_dir() and not any(self.checkpoints.iterdir()):
            self.checkpoints.rmdir()


@dataclass(frozen=True)
class Checkpoint:
    """Where an unfinished run goes on.

    Args:
        turns: frames read, mapped or held out.
        steps: steps done.
        ledger_lines: lines of the ledger up to here.
        telemetry_bytes: length of each telemetry segment up to here.
        camera_m: where the camera was last.
        simulation: the totals of simulated time so far.
        seconds: machine time by stage so far.
        state: the mapper's, by name.
    """

    turns: int
    steps: int
    ledger_lines: int
    telemetry_bytes: list[int]
    camera_m: list[float]
    simulation: dict[str, Any]
    seconds: dict[str, float]
    state: dict[str, np.ndarray]

    def write(self, path: Path) -> None:
        """Write it, whole or not at all."""
        position = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "state"}
        with written_whole(path) as temporary:
            state = {name: np.ascontiguousarray(array) for name, array in self.state.items()}
            temporary.write_bytes(save(state, {"position": json.dumps(position)}))

    @classmethod
    def read(cls, path: Path) -> Checkpoint:
        """Read it back."""
        try:
            with safe_open(path, framework="numpy") as file:
                position = json.loads((file.metadata() or {})["position"])
                state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except (SafetensorError, KeyError, ValueError) as error:
            raise ProgroundError(
                f"cannot be read as a checkpoint ({error})",
                where=path,
                todo="start the run again with --overwrite",
            ) from error
        return cls(**position, state=state)
