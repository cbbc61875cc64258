"""JSON: the objects of a map, for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from proground_log.files import written_whole
from proground_log.perception.task import Task


def write_objects_json(
    path: Path, rows: Sequence[Mapping[str, object]], task: Task, up: np.ndarray
) -> None:
    """Write objects, whole or not at all: {"task", "prompts", "frame", "up", "objects"}.

    Args:
        path: the file, replaced if it is there.
        rows: the objects as JSON values; lengths in metres, in the world's axes.
        task: what was looked for.
        up: the world's upward direction [3], to which the boxes' yaw and height refer.
    """
    content = {
        "task": task.name,
        "prompts": list(task.prompts),
        "frame": "world",
        "up": [round(float(value), 6) + 0.0 for value in up],
        "objects": list(rows),
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", "utf-8")
