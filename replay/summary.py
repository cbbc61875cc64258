"""What a run came to: the figures of its manifest, its table and its telemetry."""

from __future__ import annotations

import resource

from proground_log.mapping.map_file import NeuralMap
from proground_log.mapping.online_mapper import OnlineMapper
from replay.tally import Tally


def summary_of(
    turns: int,
    steps: int,
    mapper: OnlineMapper,
    content: NeuralMap,
    tally: Tally,
    seconds: dict[str, float],
) -> dict[str, object]:
    """The figures by name; JSON values.

    Args:
        turns: frames read, mapped or held out.
        steps: optimisation steps done.
        mapper: at its end.
        content: its map.
        tally: of simulated time.
        seconds: the machine's time by stage.
    """
    buffer = mapper.buffer.statistics()
    dropped = sum(tally.dropped.values())
    return {
        "frames arrived": turns + dropped,
        "frames mapped": tally.mapped,
        "frames dropped": dropped,
        "frames held out": turns - tally.mapped,
        "steps": steps,
        "buffer samples": buffer.samples,
        "buffer keyframes": buffer.keyframes,
        "buffer MB": round(buffer.size_bytes / 1e6, 2),
        "map MB": round(sum(content.sizes_bytes().values()) / 1e6, 2),
        "peak memory MB": round(peak_memory_bytes() / 1e6),
        **_of_semantics(mapper),
        "simulation": tally.summary(),
        "machine s": {stage: round(s, 3) for stage, s in seconds.items()},
    }


def _of_semantics(mapper: OnlineMapper) -> dict[str, object]:
    if mapper.semantics is None:
        return {}
    statistics = mapper.semantics.statistics()
    return {
        "task": mapper.semantics.description.task.name,
        "semantic samples": statistics.samples,
        "semantic regions": statistics.regions,
        "semantic MB": round(statistics.size_bytes / 1e6, 2),
    }


def peak_memory_bytes() -> int:
    """Most memory this process ever had resident."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
