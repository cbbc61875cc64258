"""What the networks of the YOLO family have in common: a square input, anchors, crowded boxes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from proground_log.errors import ProgroundError
from proground_log.perception.onnx.masks import COEFFICIENTS, PROTOTYPE_STRIDE
from proground_log.perception.onnx.session import OnnxModel

STRIDES = (8, 16, 32)
"""Pixels from anchor to anchor on each level."""
MOST_BOXES = 300
"""Boxes that stay of an image (YOLO-World's and FastSAM's own limit)."""


def contract_error(what: str, path: Path) -> ProgroundError:
    """The error of a file that breaks its contract."""
    return ProgroundError(
        what, where=path, todo="export it under the contract in docs/perception.md"
    )


def input_side(model: OnnxModel) -> int:
    """The side S of the network's input `images` [1, 3, S, S], in pixels.

    Raises:
        ProgroundError: the file leaves it open, or it is no multiple of the coarsest stride.
    """
    shapes = {node.name: node.shape for node in model.session.get_inputs()}
    height, width = shapes["images"][2:]
    if not isinstance(height, int) or height != width or height % STRIDES[-1]:
        raise contract_error(
            f"input 'images' is {height} x {width}, not a fixed square of a multiple of "
            f"{STRIDES[-1]} pixels",
            model.path,
        )
    return height


def require_shape(
    outputs: dict[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path
) -> None:
    """Raise a ProgroundError unless the output has this shape and only finite numbers."""
    if outputs[name].shape != shape:
        found = list(outputs[name].shape)
        raise contract_error(f"output {name!r} has shape {found}, not {list(shape)}", path)
    require_finite(outputs, name, path)


def require_mask_shapes(
    outputs: dict[str, np.ndarray], anchors: int, side: int, path: Path
) -> None:
    """The same for the outputs that masks are made of."""
    cells = side // PROTOTYPE_STRIDE
    require_shape(outputs, "mask_coefficients", (anchors, COEFFICIENTS), path)
    require_shape(outputs, "mask_prototypes", (COEFFICIENTS, cells, cells), path)


def require_finite(outputs: dict[str, np.ndarray], name: str, path: Path) -> None:
    """Raise a ProgroundError unless the output has only finite numbers."""
    if not np.isfinite(outputs[name]).all():
        raise contract_error(f"output {name!r} has numbers that are not finite", path)


def distinct_boxes(boxes: np.ndarray, scores: np.ndarray, most_overlap: float) -> np.ndarray:
    """Greedy non-maximum suppression.

    Args:
        boxes: float32 [N, 4], x0 y0 x1 y1.
        scores: float32 [N], > 0.
        most_overlap: of two boxes with more intersection over union, the lower score goes.

    Returns:
        Rows that stay, int64 [at most 300], by falling score, equal ones in their order.
    """
    if not len(boxes):
        return np.zeros(0, np.int64)
    corner_and_size = boxes.astype(np.float64)
    corner_and_size[:, 2:] -= corner_and_size[:, :2]
    rows = cv2.dnn.NMSBoxes(corner_and_size.tolist(), scores.tolist(), 0.0, most_overlap)
    return np.array(rows, np.int64)[:MOST_BOXES]
