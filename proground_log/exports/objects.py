"""The objects of a finished run, as tables have them."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from proground_log.files import written_whole
from proground_log.mapping.boxes import OrientedBox
from proground_log.mapping.objects import SceneObject
from proground_log.perception.task import Task


def write_objects_csv(path: Path, objects: Sequence[SceneObject]) -> None:
    """Write a CSV file, a row an object, whole or not at all; lengths are in metres."""
    text = io.StringIO()
    rows = [_flat(row) for row in object_rows(objects)]
    names = list(rows[0]) if rows else ["number", "label"]
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with written_whole(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def object_rows(objects: Sequence[SceneObject]) -> list[dict[str, object]]:
    """The objects as JSON values, numbered from 1; to the millimetre and a tenth of a degree."""
    return [
        {
            "number": number,
            "label": thing.label,
            "position_m": rounded(thing.position_m),
            "box": box_json(thing.box),
            "score": round(thing.score, 4),
            "vertices": len(thing.vertices),
            "views": thing.views,
        }
        for number, thing in enumerate(objects, start=1)
    ]


def box_json(box: OrientedBox) -> dict[str, object]:
    """An upright box as JSON values; the extent is length, width and height."""
    return {
        "centre_m": rounded(box.centre_m),
        "extent_m": rounded(box.extent_m),
        "yaw_deg": round(float(np.degrees(box.yaw_rad)), 1) + 0.0,
    }


def place_text(vector_m: np.ndarray, between: str = " ") -> str:
    """A place to the centimetre, for tables."""
    return between.join(f"{value:.2f}" for value in rounded(vector_m, 2))


def rounded(vector_m: np.ndarray, digits: int = 3) -> list[float]:
    """To the millimetre; adding 0 makes 0 of -0."""
    return [round(float(value), digits) + 0.0 for value in vector_m]


def _flat(row: dict[str, object]) -> dict[str, object]:
    """A row of numbers and names alone: a column for each coordinate."""
    flat: dict[str, object] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            flat |= {f"{name}_{key}": part for key, part in _flat(value).items()}
        elif isinstance(value, list):
            flat |= {f"{name}_{axis}": part for axis, part in zip("xyz", value, strict=True)}
        else:
            flat[name] = value
    return flat


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
