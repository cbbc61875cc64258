"""The perception of a log, and the task that its ground truth suggests."""

from __future__ import annotations

from collections.abc import Callable

from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.perception.description import ATTACHMENT, PerceptionDescription
from proground_log.perception.task import Task

_BACKGROUND = frozenset({"wall", "floor", "ceiling"})


def perception_of(reader: LogReader) -> PerceptionDescription | None:
    """What made a log's regions, None where it has none.

    Raises:
        ProgroundError: it is damaged, or another than the one that the log names.
    """
    attachment = reader.attachment(ATTACHMENT)
    if attachment is None and reader.task is None:
        return None
    if attachment is None or reader.task is None:
        missing = "its perception" if attachment is None else "its task"
        raise _error(f"has regions, but {missing} is missing", reader)
    description = PerceptionDescription.from_bytes(attachment, where=reader.path)
    if reader.task.sha256 != description.task.sha256:
        names = f"{reader.task.name!r} and {description.task.name!r}"
        raise _error(f"names one task and has the perception of another ({names})", reader)
    return description


def task_of_labels(reader: LogReader, knows: Callable[[str], bool]) -> Task:
    """The task to find every class of a log's ground truth but walls, floors and ceilings.

    Args:
        reader: the log.
        knows: whether a class can be asked for; others are left out.

    Raises:
        ProgroundError: the log has no labels.
    """
    names = [prompt_of(name) for _, name in sorted(reader.label_names.items())]
    prompts = [name for name in names if name not in _BACKGROUND and knows(name)]
    if not prompts:
        raise ProgroundError(
            "has no ground-truth classes to make a task of",
            where=reader.path,
            todo="give a task with --task",
        )
    # Two labels may have one name.
    content = {"name": "everything", "prompts": list(dict.fromkeys(prompts))}
    return Task.from_json(content, where=reader.path)


def prompt_of(name: str) -> str:
    """The name of a class as a task spells it."""
    return " ".join(name.split()).lower()


def _error(what: str, reader: LogReader) -> ProgroundError:
    return ProgroundError(what, where=reader.path, todo="run `pglog perceive` again")
