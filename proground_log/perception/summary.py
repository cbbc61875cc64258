"""What perception found in a log, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proground_log.perception.of_log import prompt_of
from proground_log.perception.task import Task
from proground_log.regions import Regions


@dataclass(frozen=True)
class PerceivedSummary:
    """What perception found.

    Args:
        frames: looked at.
        regions: found in them.
        covered: share of all pixels that belong to a region.
        by_prompt: regions by the prompt that they are most relevant to.
        right: share of the pixels whose true class is a prompt that belong to a region most
            relevant to just that; None where there are no such pixels.
    """

    frames: int
    regions: int
    covered: float
    by_prompt: dict[str, int]
    right: float | None


class Tally:
    """Counts frame by frame.

    Args:
        task: what is looked for.
        label_names: true classes by label, {} where they are not known.
    """

    def __init__(self, task: Task, label_names: dict[int, str]) -> None:
        self._prompts = task.all_prompts
        self._by_prompt = np.zeros(len(self._prompts), np.int64)
        self._frames = self._pixels = self._covered = self._labelled = self._right = 0
        # The prompt that names each label's class, -1 where none does.
        self._prompt_of = np.full(2**16, -1)
        for label, name in label_names.items():
            if prompt_of(name) in self._prompts:
                self._prompt_of[label] = self._prompts.index(prompt_of(name))

    def add(self, regions: Regions, labels: np.ndarray | None) -> None:
        """Count the regions of a frame; labels uint16 [H, W] like its image of owners."""
        self._frames += 1
        self._by_prompt += np.bincount(regions.labels, minlength=len(self._prompts))
        self._pixels += regions.owner.size
        self._covered += int(np.count_nonzero(regions.owner))
        if labels is not None:
            true = self._prompt_of[labels]
            found = np.concatenate([[-2], regions.labels])[regions.owner]
            self._labelled += int((true >= 0).sum())
            self._right += int((true == found).sum())

    def summary(self) -> PerceivedSummary:
        """The numbers so far."""
        return PerceivedSummary(
            frames=self._frames,
            regions=int(self._by_prompt.sum()),
            covered=self._covered / max(self._pixels, 1),
            by_prompt=dict(zip(self._prompts, self._by_prompt.tolist(), strict=True)),
            right=self._right / self._labelled if self._labelled else None,
        )
