"""Options that say how regions are found, for every command that finds them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from proground_log.errors import ProgroundError

if TYPE_CHECKING:
    from proground_log.log.reader import LogReader
    from proground_log.perception.perceiver import Perceiver
    from proground_log.perception.task import Task
    from proground_log.perception.texts import TextSpace


@dataclass(frozen=True)
class PerceptionOptions:
    """How regions are found."""

    task: Path | None = None
    """What to look for (.toml); with --simulated, by default all classes of the log."""
    detector: Path | None = None
    """Detects prompts (.onnx)."""
    segmenter: Path | None = None
    """Finds masks for the detector's boxes (.onnx)."""
    vocabulary: Path | None = None
    """The prompts' embeddings (.npz)."""
    text_encoder: Path | None = None
    """Computes the prompts' embeddings (.onnx)."""
    simulated: bool = False
    """Find what the ground truth says, with errors like a detector's."""
    simulated_seed: int | None = None
    """Of these errors, 0 by default."""

    @property
    def is_given(self) -> bool:
        """Whether there are any."""
        return self != PerceptionOptions()

    @property
    def files(self) -> dict[str, Path]:
        """The files that are given, by option."""
        names = ("detector", "segmenter", "vocabulary", "text_encoder")
        paths = {f"--{name.replace('_', '-')}": getattr(self, name) for name in names}
        return {option: path for option, path in paths.items() if path is not None}


def open_perceiver(reader: LogReader, options: PerceptionOptions) -> Perceiver:
    """The perceiver that the options name; raises a ProgroundError where they do not fit."""
    files = options.files
    if options.simulated:
        if files:
            raise _contradiction(f"--simulated has no use for {', '.join(files)}")
        _require_labels(reader)
        return simulated_perceiver(reader, asked_task(reader, options), options.simulated_seed or 0)
    if options.simulated_seed is not None:
        raise _contradiction("--simulated-seed is for --simulated alone")
    if options.task is None:
        raise _missing("there is no task", "give one with --task")
    if "--detector" not in files:
        raise _missing("there is no detector", "give one with --detector, or pass --simulated")
    from proground_log.perception.onnx.perceiver import OnnxPerception
    from proground_log.perception.task import read_task

    task, texts = read_task(options.task), given_texts(options)
    return OnnxPerception(task, texts, files["--detector"], files.get("--segmenter"))


def perceiver_of_replay(reader: LogReader, options: PerceptionOptions) -> Perceiver | None:
    """The perceiver of a replay; None where the log's own regions serve, or none are asked for.

    Raises:
        ProgroundError: the log has regions already, of another task or to be found again.
    """
    from proground_log.perception.of_log import perception_of
    from proground_log.perception.task import read_task

    description = perception_of(reader)
    if description is None:
        return open_perceiver(reader, options) if options.is_given else None
    if options.files or options.simulated:
        raise ProgroundError(
            f"has regions already, for the task {description.task.name!r}",
            where=reader.path,
            todo="leave the options of perception out, or replay the log without regions",
        )
    if options.task is not None and read_task(options.task).sha256 != description.task.sha256:
        raise ProgroundError(
            f"was perceived for another task, {description.task.name!r}",
            where=reader.path,
            todo=f"leave --task out, or run `pglog perceive` for {options.task}",
        )
    return None


def asked_task(reader: LogReader, options: PerceptionOptions) -> Task:
    """The task that is given, or all classes of the log's ground truth."""
    from proground_log.perception.builtin_texts import BuiltinTexts
    from proground_log.perception.of_log import task_of_labels
    from proground_log.perception.task import read_task

    if options.task is not None:
        return read_task(options.task)
    return task_of_labels(reader, BuiltinTexts().knows)


def simulated_perceiver(reader: LogReader, task: Task, seed: int) -> Perceiver:
    """The simulated detector on a log with labels."""
    from proground_log.perception.simulated.perceiver import SimulatedPerception

    _require_labels(reader)
    return SimulatedPerception(task, reader.label_names, reader.calibration.color, seed)


def _require_labels(reader: LogReader) -> None:
    if not reader.label_names:
        raise ProgroundError(
            "has no ground-truth labels, which --simulated needs",
            where=reader.path,
            todo="choose a log with labels, or give a detector with --detector",
        )


def given_texts(options: PerceptionOptions) -> TextSpace:
    """What turns prompts into embeddings."""
    from proground_log.perception.onnx.text_encoder import OnnxTextEncoder
    from proground_log.perception.vocabulary import Vocabulary

    if options.vocabulary is not None and options.text_encoder is not None:
        raise _contradiction("--vocabulary and --text-encoder are both given")
    if options.vocabulary is not None:
        return Vocabulary(options.vocabulary)
    if options.text_encoder is not None:
        return OnnxTextEncoder(options.text_encoder)
    raise _missing("nothing embeds the prompts", "give --vocabulary or --text-encoder")


def _contradiction(what: str) -> ProgroundError:
    return ProgroundError(what, where="perceive", todo="leave one out")


def _missing(what: str, todo: str) -> ProgroundError:
    return ProgroundError(what, where="perceive", todo=todo)
