"""The command that needs nothing: demo."""

from __future__ import annotations

from proground_log.cli.common import SAME, Output
from proground_log.cli.logs import record_command
from proground_log.cli.runs import evaluate_command, replay_command
from replay.config import ReplayConfig


def demo_command(*, output: Output, seed: int = 0, overwrite: bool = False) -> int:
    """Record the built-in room, map it and judge the map: all of it, in about two minutes.

    Args:
        output: folder for room.mcap and run/.
        seed: varies the room and every draw.
        overwrite: replace an earlier demo.
    """
    log, run = output / "room.mcap", output / "run"
    record_command("synthetic", output=log, seed=seed, overwrite=overwrite)
    config = ReplayConfig(seed=seed, hold_out_every=10)
    replay_command(log, output=run, config=config, overwrite=overwrite)
    evaluate_command(run)
    print(f"\nlook at it:      pglog view {run}\nlook at the log: pglog view {log}")
    return SAME
