"""How right the labels of regions are, against ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.regions import Regions


@dataclass(frozen=True)
class LabelCounts:
    """How right the regions' labels are, in pixels whose true class is among the prompts.

    Args:
        labelled: how many such pixels there are.
        found: those of them that belong to a region.
        right: those of them whose region's label is the true class.
    """

    labelled: int
    found: int
    right: int

    def __add__(self, other: LabelCounts) -> LabelCounts:
        return LabelCounts(
            self.labelled + other.labelled, self.found + other.found, self.right + other.right
        )

    @property
    def accuracy(self) -> float:
        """Share of the labelled pixels that are right."""
        return self.right / max(self.labelled, 1)

    @property
    def precision(self) -> float:
        """Share of the found pixels that are right."""
        return self.right / max(self.found, 1)

    @property
    def coverage(self) -> float:
        """Share of the labelled pixels that are found."""
        return self.found / max(self.labelled, 1)


def count_labels(
    regions: Regions,
    labels: np.ndarray,
    label_names: dict[int, str],
    prompts: tuple[str, ...],
    relevance: float = 0.05,
) -> LabelCounts:
    """Compare regions with ground truth; a synonym of the true class is right.

    Args:
        regions: of the image.
        labels: uint16 [H, W], 0 for nothing.
        label_names: class names by label.
        prompts: of the task, all of them.
        relevance: regions below it count as not there.
    """
    texts = BuiltinTexts()
    concepts = [texts.concept(prompt) for prompt in prompts]
    first = {concept: n for n, concept in reversed(list(enumerate(concepts)))}
    wanted = np.full(max(int(labels.max()), *label_names) + 1, -1)
    for label, name in label_names.items():
        if label > 0 and texts.knows(name):
            wanted[label] = first.get(texts.concept(name), -1)
    meant = np.array([first[concepts[label]] for label in regions.labels], dtype=np.int64)
    given = np.where(regions.confidence >= relevance, meant, -1)
    true, said = wanted[labels], np.append(-1, given)[regions.owner]
    asked = true >= 0
    return LabelCounts(
        labelled=int(asked.sum()),
        found=int((asked & (said >= 0)).sum()),
        right=int((asked & (said == true)).sum()),
    )
