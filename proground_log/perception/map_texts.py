"""Texts in the space that a map was made in: for its queries and its evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.onnx.text_encoder import OnnxTextEncoder
from proground_log.perception.texts import NameIndex, TextSpace
from proground_log.perception.vocabulary import Vocabulary

SAME_SPACE_COSINE = 0.8
"""Two templates around one name ("a chair", "a photo of a chair") come closer than this."""


@dataclass(frozen=True)
class Texts:
    """Where texts that the map does not know by itself come from; see `texts_for`."""

    vocabulary: Path | None = None
    text_encoder: Path | None = None


class TaskTexts:
    """The prompts of a task alone: all that a map knows by itself.

    Args:
        description: what made the map's regions.
    """

    origin = {"kind": "task"}  # noqa: RUF012 - a constant, and TextSpace wants an attribute

    def __init__(self, description: PerceptionDescription) -> None:
        self._embeddings = description.texts
        where = f"the task {description.task.name!r} (more texts: --vocabulary or --text-encoder)"
        self._index = NameIndex(description.task.all_prompts, where)

    def embed(self, names: Sequence[str]) -> np.ndarray:
        """Embeddings float32 [N, 512]; raises a ProgroundError for what is no prompt."""
        return self._embeddings[[self._index.row(name) for name in names]]


def texts_for(
    description: PerceptionDescription, vocabulary: Path | None, text_encoder: Path | None
) -> TextSpace:
    """The texts to ask a map with: those given, else the built-in ones, else its own prompts.

    Args:
        description: what made the map's regions.
        vocabulary: a vocabulary file of the same space, or None.
        text_encoder: a text encoder of the same space, or None.

    Raises:
        ProgroundError: a file is broken, or has embeddings of another space.
    """
    if vocabulary is not None:
        return _of_one_space(Vocabulary(vocabulary), description, vocabulary)
    if text_encoder is not None:
        return _of_one_space(OnnxTextEncoder(text_encoder), description, text_encoder)
    if description.origin.get("kind") == "simulated":
        return BuiltinTexts()
    return TaskTexts(description)


def _of_one_space(texts: TextSpace, description: PerceptionDescription, path: Path) -> TextSpace:
    """Return the texts; raise a ProgroundError unless a prompt means there what it does here."""
    for prompt, expected in zip(description.task.all_prompts, description.texts, strict=True):
        try:
            embedding = texts.embed([prompt])[0]
        except ProgroundError:
            continue
        if float(embedding @ expected) < SAME_SPACE_COSINE:
            raise ProgroundError(
                f"has embeddings of another space: {prompt!r} means something else in the map",
                where=path,
                todo="give the texts that the log was perceived with",
            )
        break
    return texts
