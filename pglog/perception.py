"""Commands about perception: perceive, vocabulary."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from pglog.common import (
    SAME,
    STOPPED,
    Log,
    Output,
    print_table,
    shown_progress,
)
from pglog.parsing import Group, description
from proground_log.perception.opening import PerceptionOptions, open_perceiver

if TYPE_CHECKING:
    from proground_log.perception.summary import PerceivedSummary


def perceive_command(
    log: Log,
    *,
    output: Output,
    perception: Annotated[PerceptionOptions, tyro.conf.arg(name="")] = PerceptionOptions(),
    overwrite: bool = False,
) -> int:
    """Find what a task asks for in each frame, and keep it in a new log.

    Args:
        log: the log (.mcap).
        output: the log to write, with regions (.mcap).
        perception: how regions are found.
        overwrite: replace the output.
    """
    from proground_log.files import require_free
    from proground_log.log.reader import LogReader
    from proground_log.perception.perceive import perceive

    require_free(output, overwrite=overwrite)
    perceiver = open_perceiver(LogReader(log), perception)
    try:
        with shown_progress("perceive") as progress:
            summary = perceive(log, perceiver, output, overwrite=overwrite, progress=progress)
    except KeyboardInterrupt:
        print("pglog: stopped; run the same command again to go on", file=sys.stderr)
        return STOPPED
    _print_summary(output, perceiver.description.task.name, summary)
    return SAME


def _print_summary(output: Path, task: str, summary: PerceivedSummary) -> None:
    rows = {
        "task": task,
        "frames": str(summary.frames),
        "regions": f"{summary.regions} ({summary.regions / max(summary.frames, 1):.1f} a frame)",
        "pixels in a region": f"{summary.covered:.1%}",
    }
    if summary.right is not None:
        rows["labelled pixels right"] = f"{summary.right:.1%}"
    print_table(str(output), rows)
    counts = sorted(summary.by_prompt.items(), key=lambda item: -item[1])
    print_table("regions by prompt", {prompt: str(count) for prompt, count in counts})


def vocabulary_build_command(
    names: Annotated[Path, Positional, tyro.conf.arg(metavar="NAMES")],
    *,
    text_encoder: Path,
    output: Output,
    overwrite: bool = False,
) -> int:
    """Embed a list of names, so that later no text encoder is needed.

    Args:
        names: UTF-8 text, one name a line.
        text_encoder: computes the embeddings (.onnx).
        output: the vocabulary to write (.npz).
        overwrite: replace the output.
    """
    from proground_log.files import require_free
    from proground_log.perception.onnx.text_encoder import OnnxTextEncoder
    from proground_log.perception.vocabulary import Vocabulary, build_vocabulary

    require_free(output, overwrite=overwrite)
    with shown_progress("embed") as progress:
        build_vocabulary(names, OnnxTextEncoder(text_encoder), output, progress)
    print(f"{output}: {len(Vocabulary(output).names)} names")
    return SAME


VOCABULARY_COMMANDS = Group(
    "Make files of text embeddings.",
    {"build": description(vocabulary_build_command)},
    {"build": vocabulary_build_command}.__getitem__,
)
