"""Which pixel belongs to which region: masks mixed from prototypes, fitted to boxes, settled.

YOLO networks with masks give a few prototype images and, for each box, the coefficients that mix
them; the mask is where the mixture is positive, inside the box. Masks are mixed one at a time and
only inside their box, so that memory does not grow with their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from proground_log.perception.onnx.letterbox import Letterbox

PROTOTYPE_STRIDE = 4
"""Pixels of the letter-boxed image by pixel of a prototype."""
COEFFICIENTS = 32
"""Prototypes that a mask is mixed of."""
LEAST_FIT = 0.3
"""A mask that fits a box by less stands for something else in it."""


@dataclass(frozen=True)
class Segments:
    """Masks of one image, not mixed yet.

    Args:
        boxes: float32 [M, 4], x0 y0 x1 y1 in pixels of the image: where each mask ends.
        coefficients: float32 [M, 32].
        prototypes: float32 [32, S/4, S/4].
        letterbox: where the image lies in the prototypes.
    """

    boxes: np.ndarray
    coefficients: np.ndarray
    prototypes: np.ndarray
    letterbox: Letterbox


def pixels_of(box: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the pixels whose centres lie in a box [4] (x0 y0 x1 y1)."""
    x0, y0, x1, y1 = np.ceil(box - np.float32(0.5)).astype(int).tolist()
    return slice(y0, max(y0, y1)), slice(x0, max(x0, x1))


def covers_pixels(boxes: np.ndarray) -> np.ndarray:
    """Whether the centre of any pixel lies in each of the boxes [N, 4]: bool [N]."""
    edges = np.ceil(boxes - np.float32(0.5))
    return np.all(edges[:, 2:] > edges[:, :2], axis=1)


def mask_in_box(
    segments: Segments, number: int, box: np.ndarray
) -> tuple[tuple[slice, slice], np.ndarray]:
    """One mask at the image's resolution, where a box [4] and the mask's own overlap.

    The mixture is interpolated, then cut at zero: its edge is finer than the prototypes' pixels.

    Returns:
        Rows and columns of a window of the image, and the mask there, bool.
    """
    window = rows, columns = pixels_of(_overlap(box, segments.boxes[number]))
    width, height = columns.stop - columns.start, rows.stop - rows.start
    if not width or not height:
        return window, np.zeros((height, width), bool)
    # Column u of the window lies at column scale_x u + start_x of the prototypes; rows alike.
    scale = segments.letterbox.scale.astype(np.float64) / PROTOTYPE_STRIDE
    corner = np.array([columns.start, rows.start]) + 0.5
    start = corner * scale + np.divide(segments.letterbox.padding, PROTOTYPE_STRIDE) - 0.5
    last = np.array(segments.prototypes.shape[:0:-1]) - 1
    x0, y0 = low = np.clip(np.floor(start).astype(int), 0, last)
    end = start + scale * (width - 1, height - 1)
    x1, y1 = np.clip(np.ceil(end).astype(int), 0, last) + 1
    x, y = start - low
    mixture = cv2.warpAffine(
        _mixture(segments, number, slice(y0, y1), slice(x0, x1)),
        np.array([[scale[0], 0, x], [0, scale[1], y]]),
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return window, mixture > 0


def best_segments(boxes: np.ndarray, segments: Segments) -> np.ndarray:
    """The mask that fits each box best, as FastSAM's box prompt has it.

    The fit of mask m and box b is |m and b| / (|b| + |m| - |m and b|), areas on the prototypes'
    pixels, of which a box may hold parts.

    Args:
        boxes: float32 [N, 4], x0 y0 x1 y1 in pixels of the image.
        segments: the masks to choose from, each cut to its own box.

    Returns:
        int64 [N], the mask's number, the lowest of equals; -1 where none reaches `LEAST_FIT`.
    """
    best, best_fit = np.full(len(boxes), -1), np.zeros(len(boxes))
    scale = np.tile(segments.letterbox.scale.astype(np.float64), 2) / PROTOTYPE_STRIDE
    shift = np.tile(segments.letterbox.padding, 2) / PROTOTYPE_STRIDE
    boxes = boxes * scale + shift
    box_areas = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    for number, own_box in enumerate(segments.boxes * scale + shift):
        x0, y0 = np.floor(own_box[:2]).astype(int)
        x1, y1 = np.ceil(own_box[2:]).astype(int)
        mixture = _mixture(segments, number, slice(y0, y1), slice(x0, x1))
        sums = cv2.integral((mixture > 0).astype(np.uint8)).astype(np.float64)
        regions = np.concatenate([_overlap(boxes, own_box), own_box[None]])
        *shared, own_area = _areas(sums, regions - (x0, y0, x0, y0))
        fit = np.array(shared) / (box_areas + own_area - shared)
        is_better = fit > best_fit
        best[is_better], best_fit[is_better] = number, fit[is_better]
    return np.where(best_fit < LEAST_FIT, -1, best)


def assign_owners(
    boxes: np.ndarray, segments: Segments, choice: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Settle which region each pixel of the image belongs to.

    Where masks overlap the lower number wins; then each region loses the pixels at its rim, where
    a mask bleeds over the edge of the thing.

    Args:
        boxes: float32 [N, 4] of the regions, in pixels of the image, the most relevant first.
        segments: their masks.
        choice: int64 [N], the mask of each region; -1: none fits, so that the box stands in, as
            it does for a mask without a pixel.

    Returns:
        owner: uint16 [H, W], 1 + the region's number, 0 for none.
        is_box: bool [N], where the box stands in.
    """
    owner = np.zeros((segments.letterbox.height, segments.letterbox.width), np.uint16)
    is_box = np.ones(len(boxes), bool)
    for number in reversed(range(len(boxes))):
        if choice[number] >= 0:
            window, mask = mask_in_box(segments, int(choice[number]), boxes[number])
            owner[window][mask] = number + 1
            is_box[number] = not mask.any()
        if is_box[number]:
            owner[pixels_of(boxes[number])] = number + 1
    return without_rims(owner), is_box


def without_rims(owner: np.ndarray) -> np.ndarray:
    """An owner image [H, W] that is 0 where one of the 8 neighbours belongs to another."""
    around = np.ones((3, 3), np.uint8)
    is_inner = cv2.erode(owner, around) == cv2.dilate(owner, around)
    return np.where(is_inner, owner, np.uint16(0))


def _overlap(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Boxes [..., 4] cut to another [4]; without area where they do not meet it."""
    low, high = np.maximum(boxes[..., :2], box[:2]), np.minimum(boxes[..., 2:], box[2:])
    return np.concatenate([low, np.maximum(low, high)], axis=-1)


def _mixture(segments: Segments, number: int, rows: slice, columns: slice) -> np.ndarray:
    """A mask's prototypes mixed, float32, in a window; not by BLAS, which rounds by threads."""
    return np.einsum(
        "c,chw->hw", segments.coefficients[number], segments.prototypes[:, rows, columns]
    )


def _areas(sums: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Area of a mask in boxes [N, 4] from its summed-area table, exact in parts of pixels."""
    corners = np.stack([boxes[:, [1, 1, 3, 3]], boxes[:, [0, 2, 0, 2]]])
    a, b, c, d = map_coordinates(sums, corners, order=1, mode="nearest").T
    return d - c - b + a
