"""The command that needs nothing: demo."""

from __future__ import annotations

from pglog.common import SAME, Output
from pglog.objects import objects_command
from pglog.perception import perceive_command
from pglog.query import query_command
from pglog.record import record_data_set
from pglog.runs import evaluate_command, replay_command
from proground_log.perception.opening import PerceptionOptions
from proground_log.run.settings import ReplayConfig


def demo_command(*, output: Output, seed: int = 0, overwrite: bool = False) -> int:
    """Record the built-in room, perceive, map, judge and ask: all of it, in about three minutes.

    Args:
        output: folder for room.mcap, seen.mcap, run/ and objects.rrd.
        seed: varies the room and every draw.
        overwrite: replace an earlier demo.
    """
    room, seen, run = output / "room.mcap", output / "seen.mcap", output / "run"
    objects = output / "objects.rrd"
    record_data_set("synthetic", None, output=room, seed=seed, overwrite=overwrite)
    perception = PerceptionOptions(simulated=True, simulated_seed=seed)
    perceive_command(room, output=seen, perception=perception, overwrite=overwrite)
    config = ReplayConfig(seed=seed, hold_out_every=10)
    replay_command(seen, output=run, config=config, overwrite=overwrite)
    evaluate_command(run)
    objects_command(run, rrd=objects, overwrite=overwrite)
    query_command(run, ("sofa", "couch", "cup on table"))
    print(f"\nlook at the run: pglog view {run}\nlook at the log: pglog view {seen}")
    print(f'ask the map:     pglog query {run} "lamp"')
    return SAME
