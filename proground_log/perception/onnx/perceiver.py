"""Perception by ONNX files: from a frame's colour image to its regions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.onnx.detector import Detector
from proground_log.perception.onnx.masks import assign_owners, best_segments
from proground_log.perception.onnx.segmenter import Segmenter
from proground_log.perception.task import Task
from proground_log.perception.texts import TextSpace
from proground_log.regions import Regions


class OnnxPerception:
    """Finds a task's prompts in frames (paper, 4.1): a prompted detector, then masks for its boxes.

    Args:
        task: what to look for.
        texts: embeds its prompts; must be the text space that the detector was trained with.
        detector: its ONNX file.
        segmenter: another one, for the masks; without it the detector's own are taken.

    Attributes:
        description: what makes the regions, to be kept with them.

    Raises:
        ProgroundError: a file breaks its contract, there is nothing to take masks from, or the
            text space does not know a prompt.
    """

    def __init__(
        self, task: Task, texts: TextSpace, detector: Path, segmenter: Path | None = None
    ) -> None:
        self._texts = texts.embed(task.all_prompts)
        self._thresholds = task.thresholds
        self._detector = Detector(detector)
        self._segmenter = Segmenter(segmenter) if segmenter else None
        if self._segmenter is None and not self._detector.has_masks:
            raise ProgroundError(
                "the detector gives no masks",
                where=detector,
                todo="give a segmenter too (--segmenter), or export the detector with masks",
            )
        origin = {"kind": "onnx"}
        parts = {"detector": self._detector, "segmenter": self._segmenter}
        for name, part in parts.items():
            if part is not None:
                origin |= {name: part.model.path.name, f"{name}.sha256": part.model.sha256}
        origin |= {f"texts.{name}": value for name, value in texts.origin.items()}
        self.description = PerceptionDescription(task, self._texts, self._detector.heads, origin)

    def __call__(self, frame: SensorFrame) -> Regions:
        """The regions of a frame's colour image; raises a ProgroundError where it is broken."""
        image = frame.decode_color()
        found = self._detector.detect(
            image,
            self._texts,
            least_relevance=self._thresholds.detection,
            most_overlap=self._thresholds.overlap,
        )
        segments, choice = found.segments, np.arange(len(found))
        if self._segmenter is not None:
            segments = self._segmenter.segment(image)
            choice = best_segments(found.boxes, segments)
        assert segments is not None  # Or the constructor would have refused.
        owner, is_box = assign_owners(found.boxes, segments, choice)
        return Regions(
            boxes=found.boxes,
            levels=found.levels,
            relevance=found.relevance,
            embeddings=found.embeddings,
            owner=owner,
            is_box=is_box,
        )
