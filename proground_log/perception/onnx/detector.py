"""A prompted detector as an ONNX file: boxes, relevance to texts, and an embedding a region."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import expit

from proground_log.perception.heads import TextHeads
from proground_log.perception.onnx.letterbox import Letterbox
from proground_log.perception.onnx.masks import COEFFICIENTS, Segments, covers_pixels
from proground_log.perception.onnx.session import Shape, open_session
from proground_log.perception.onnx.yolo import (
    STRIDES,
    contract_error,
    distinct_boxes,
    input_side,
    require_finite,
    require_mask_shapes,
    require_shape,
)
from proground_log.regions import EMBEDDING_WIDTH, LEVELS
from proground_log.streams import stream

CONTRACT = "1"
"""What a detector file says under `proground.contract` in its metadata."""
LOGIT_TOLERANCE = 0.01
"""A logit that is off by this shifts a relevance by 0.0025; networks in float32 stay far below,
those with half-precision layers near it."""

_MASKS: dict[str, Shape] = {
    "mask_coefficients": ("A", COEFFICIENTS),
    "mask_prototypes": (COEFFICIENTS, "S/4", "S/4"),
}
_HEADS: dict[str, Shape] = {
    "head_scale": (LEVELS, EMBEDDING_WIDTH),
    "head_shift": (LEVELS, EMBEDDING_WIDTH),
    "head_logit_scale": (LEVELS,),
    "head_bias": (LEVELS,),
}


@dataclass(frozen=True)
class Detections:
    """What a detector found in one image, by falling confidence, then by anchor.

    Args:
        boxes: float32 [N, 4], x0 y0 x1 y1 in pixels of the image, clipped to it.
        levels: uint8 [N], 0 to 2.
        relevance: float32 [N, K], to each text.
        embeddings: float16 [N, 512], before the head of their level.
        segments: the mask of each; None from a detector without masks.
    """

    boxes: np.ndarray
    levels: np.ndarray
    relevance: np.ndarray
    embeddings: np.ndarray
    segments: Segments | None

    def __len__(self) -> int:
        return len(self.boxes)


class Detector:
    """Opens a detector file and finds what texts name.

    On opening, the network sees one made-up image with two made-up texts, to prove that it keeps
    the whole contract of docs/perception.md, its heads above all: a map is queried through them.

    Args:
        path: the ONNX file.

    Attributes:
        heads: from a region's embedding to logits.
        has_masks: whether the network gives masks.

    Raises:
        ProgroundError: the file breaks the contract; says where.
    """

    def __init__(self, path: Path) -> None:
        self.model = open_session(
            path,
            kind="detector",
            inputs={"images": (1, 3, "S", "S"), "text": ("K", EMBEDDING_WIDTH)},
            outputs={
                "boxes": ("A", 4),
                "logits": ("A", "K"),
                "embeddings": ("A", EMBEDDING_WIDTH),
                **_HEADS,
            },
            optional_outputs=_MASKS,
        )
        masks = self.model.output_names & _MASKS.keys()
        self.has_masks = len(masks) == len(_MASKS)
        if masks and not self.has_masks:
            raise contract_error(f"has only one of the outputs {', '.join(_MASKS)}", path)
        contract = self.model.metadata.get("proground.contract")
        if contract != CONTRACT:
            raise contract_error(
                f"has proground.contract = {contract} in its metadata, not {CONTRACT}", path
            )
        self._side = input_side(self.model)
        anchors = [(self._side // stride) ** 2 for stride in STRIDES]
        self._levels = np.repeat(np.arange(LEVELS, dtype=np.uint8), anchors)
        self.heads = self._probe()

    def _probe(self) -> TextHeads:
        """The heads, once the network has shown that they are its own."""
        random = stream(0, "detector probe")
        image = random.random((1, 3, self._side, self._side), dtype=np.float32)
        texts = random.standard_normal((2, EMBEDDING_WIDTH), dtype=np.float32)
        texts /= np.linalg.norm(texts, axis=1, keepdims=True)
        outputs = self.model.run({"images": image, "text": texts})
        path, count = self.model.path, len(self._levels)
        require_shape(outputs, "boxes", (count, 4), path)
        require_shape(outputs, "logits", (count, len(texts)), path)
        require_shape(outputs, "embeddings", (count, EMBEDDING_WIDTH), path)
        if self.has_masks:
            require_mask_shapes(outputs, count, self._side, path)
        heads = TextHeads(*(outputs[name] for name in _HEADS))
        for level in range(LEVELS):
            here = self._levels == level
            expected = heads.logits(outputs["embeddings"][here], level, texts)
            deviation = np.abs(outputs["logits"][here] - expected).max()
            # A deviation that is no number fails as well.
            if not deviation <= LOGIT_TOLERANCE:
                raise contract_error(
                    f"logits on level P{level + 3} are not those of the embeddings under the "
                    f"level's head, but off by up to {deviation:.3g}",
                    path,
                )
        return heads

    def detect(
        self, image: np.ndarray, texts: np.ndarray, *, least_relevance: float, most_overlap: float
    ) -> Detections:
        """Find what the texts name.

        Boxes that overlap are one region, whichever texts they are relevant to: a region has one
        embedding. The one of the highest relevance to any text stays.

        Args:
            image: uint8 [H, W, 3] RGB.
            texts: float32 [K, 512], of length 1.
            least_relevance: regions that are less relevant to each text are left out.
            most_overlap: boxes with more intersection over union than this are one region.

        Raises:
            ProgroundError: the network gives numbers that are not finite.
        """
        letterbox = Letterbox(image.shape[1], image.shape[0], self._side)
        outputs = self.model.run({"images": letterbox.apply(image), "text": texts})
        for name in ("boxes", "logits"):
            require_finite(outputs, name, self.model.path)
        logits = outputs["logits"]
        likely = np.flatnonzero(expit(logits.max(axis=1)) >= least_relevance)
        confidence = expit(logits[likely]).max(axis=1)
        anchors = likely[distinct_boxes(outputs["boxes"][likely], confidence, most_overlap)]
        boxes = letterbox.boxes_in_image(outputs["boxes"][anchors])
        is_seen = covers_pixels(boxes)
        anchors, boxes = anchors[is_seen], boxes[is_seen]
        embeddings = outputs["embeddings"][anchors]
        # Written so that what is no number fails as well.
        if not np.all(np.abs(embeddings) <= np.finfo(np.float16).max):
            raise contract_error("output 'embeddings' has numbers beyond float16", self.model.path)
        segments = None
        if self.has_masks:
            coefficients = outputs["mask_coefficients"][anchors]
            segments = Segments(boxes, coefficients, outputs["mask_prototypes"], letterbox)
        return Detections(
            boxes=boxes,
            levels=self._levels[anchors],
            relevance=expit(logits[anchors]),
            embeddings=embeddings.astype(np.float16),
            segments=segments,
        )
