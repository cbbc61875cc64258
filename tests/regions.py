"""A tiny perceiver for tests that need regions but not a detector, and a log with what it finds."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from proground_log.frame import SensorFrame
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.heads import TextHeads
from proground_log.perception.perceive import perceive
from proground_log.perception.task import Task
from proground_log.regions import EMBEDDING_WIDTH, LEVELS, Regions
from tests.writers.small_source import LABEL_NAMES, SmallSource, write_log

TASK = Task("things", ("chair", "küche"), ("lamp",), colors={"lamp": "#ff8000"})


def description(seed: int = 0) -> PerceptionDescription:
    rng = np.random.default_rng(seed)
    texts = rng.normal(size=(len(TASK.all_prompts), EMBEDDING_WIDTH)).astype(np.float32)
    texts /= np.linalg.norm(texts, axis=1, keepdims=True)
    ones = np.ones((LEVELS, EMBEDDING_WIDTH), np.float32)
    heads = TextHeads(ones, 0 * ones, np.ones(LEVELS, np.float32), np.zeros(LEVELS, np.float32))
    return PerceptionDescription(TASK, texts, heads, {"kind": "test", "seed": str(seed)})


@dataclass
class LabelPerceiver:
    """Takes each true class for a region: all of its pixels, and random numbers for the rest."""

    description: PerceptionDescription = field(default_factory=description)
    seen: list[int] = field(default_factory=list)

    def __call__(self, frame: SensorFrame) -> Regions:
        assert frame.labels is not None
        assert frame.regions is None
        self.seen.append(frame.index)
        rng = np.random.default_rng(frame.index)
        # The second frame has nothing to be found.
        labels = [label for label in LABEL_NAMES if (frame.labels == label).any()]
        labels = [] if frame.index == 1 else labels
        owner = np.zeros(frame.labels.shape, np.uint16)
        boxes = np.zeros((len(labels), 4), np.float32)
        relevance = rng.uniform(0, 0.3, (len(labels), 3)).astype(np.float32)
        for number, label in enumerate(labels):
            mask = frame.labels == label
            owner[mask] = number + 1
            rows, columns = np.nonzero(mask)
            boxes[number] = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
            relevance[number, list(LABEL_NAMES).index(label)] = 0.9 - number / 10
        return Regions(
            boxes=boxes,
            levels=rng.integers(0, LEVELS, len(labels), dtype=np.uint8),
            relevance=relevance,
            embeddings=rng.normal(size=(len(labels), EMBEDDING_WIDTH)).astype(np.float16),
            owner=owner,
            is_box=rng.random(len(labels)) < 0.5,
        )


def write_perceived_log(path: Path, source: SmallSource | None = None) -> Path:
    """A log with regions; the log that it is made of lies beside it."""
    log = write_log(path.with_suffix(".source.mcap"), source or SmallSource(6, with_labels=True))
    perceive(log, LabelPerceiver(), path, overwrite=False, progress=lambda *_: None)
    return path
