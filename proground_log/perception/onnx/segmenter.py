"""A class-agnostic segmenter (FastSAM) as an ONNX file: the masks of all things in an image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from proground_log.perception.onnx.letterbox import Letterbox
from proground_log.perception.onnx.masks import COEFFICIENTS, Segments, covers_pixels
from proground_log.perception.onnx.session import open_session
from proground_log.perception.onnx.yolo import (
    distinct_boxes,
    input_side,
    require_finite,
    require_mask_shapes,
)

LEAST_SCORE = 0.4
"""Masks of a lower score are noise (FastSAM's default)."""
MOST_OVERLAP = 0.9
"""Boxes with more intersection over union have one mask (FastSAM's default)."""


class Segmenter:
    """Opens a segmenter file and finds the masks of images.

    Args:
        path: the ONNX file.

    Raises:
        ProgroundError: the file breaks the contract of docs/perception.md; says where.
    """

    def __init__(self, path: Path) -> None:
        self.model = open_session(
            path,
            kind="segmenter",
            inputs={"images": (1, 3, "S", "S")},
            outputs={
                "boxes": ("A", 4),
                "scores": ("A",),
                "mask_coefficients": ("A", COEFFICIENTS),
                "mask_prototypes": (COEFFICIENTS, "S/4", "S/4"),
            },
        )
        self._side = input_side(self.model)
        self._run(np.zeros((1, 3, self._side, self._side), np.float32))

    def segment(self, image: np.ndarray) -> Segments:
        """The masks in an image uint8 [H, W, 3] RGB, by falling score."""
        letterbox = Letterbox(image.shape[1], image.shape[0], self._side)
        outputs = self._run(letterbox.apply(image))
        likely = np.flatnonzero(outputs["scores"] >= LEAST_SCORE)
        scores = outputs["scores"][likely]
        rows = likely[distinct_boxes(outputs["boxes"][likely], scores, MOST_OVERLAP)]
        boxes = letterbox.boxes_in_image(outputs["boxes"][rows])
        is_seen = covers_pixels(boxes)
        coefficients = outputs["mask_coefficients"][rows[is_seen]]
        return Segments(boxes[is_seen], coefficients, outputs["mask_prototypes"], letterbox)

    def _run(self, image: np.ndarray) -> dict[str, np.ndarray]:
        outputs = self.model.run({"images": image})
        require_mask_shapes(outputs, len(outputs["boxes"]), self._side, self.model.path)
        for name in ("boxes", "scores"):
            require_finite(outputs, name, self.model.path)
        return outputs
