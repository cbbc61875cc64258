"""The things of a label image, and the masks that a detector would draw around them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np

SMALLEST_PIXELS = 40
"""A thing of fewer pixels, in an image 320 wide, is not seen."""
_DEPTH_JUMP = 0.1
"""Neighbours whose depth differs by more than this share of it are two things."""
_SPLIT, _MERGED, _BOX_ONLY = 0.15, 0.08, 0.03
"""How often a thing is found in two parts, with its neighbour, or without a mask."""
_RAGGED_PX, _BLEED_PX = 1.5, 3.0
"""Spread of the border's noise, and the farthest that a mask bleeds over one side, at width 320."""
_BOX_JITTER = 0.03
"""Spread of a box's edges as a share of its sides."""


@dataclass(frozen=True)
class Thing:
    """What one sees of an object: connected pixels of one class.

    Args:
        number: its number in the image of things, from 1.
        label: its class.
        box: x0, y0, x1, y1 in pixels, x1 and y1 not included.
        centre: mean column and row of its pixels, centres at +0.5.
        depth_m: mean depth of its measured pixels, 0 where there is none.
        hidden: share of its outline that a nearer surface cuts.
        truncated: share of its outline that the image's border cuts.
    """

    number: int
    label: int
    box: tuple[int, int, int, int]
    centre: tuple[float, float]
    depth_m: float
    hidden: float
    truncated: float


@dataclass(frozen=True)
class Outline:
    """A mask that a detector drew.

    Args:
        box: float32 [4], x0 y0 x1 y1 in pixels of the image.
        left, top: where the mask lies in the image.
        mask: bool [h, w].
        is_box: whether it is the whole box, for want of a mask.
    """

    box: np.ndarray
    left: int
    top: int
    mask: np.ndarray
    is_box: bool


def find_things(labels: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, list[Thing]]:
    """Cut a label image into things.

    Args:
        labels: uint16 [H, W], 0 for nothing.
        depth_m: float32 [H, W], 0 where nothing was measured.

    Returns:
        The number of the thing at each pixel, int32 [H, W], 0 for nothing; and the things that
        are large enough to be seen, by number.
    """
    numbers, count = _components(labels, depth_m)
    measures = _measure(numbers, labels, depth_m, count)
    smallest = SMALLEST_PIXELS * (labels.shape[1] / 320) ** 2
    things = []
    for number in range(1, count + 1):
        sums, (label, *box) = measures[number, :8], measures[number, 8:]
        pixels, columns, rows, depth, measured, outline, hidden, truncated = sums
        if pixels < smallest:
            continue
        x0, y0, x1, y1 = (int(value) for value in box)
        things.append(
            Thing(
                number=number,
                label=int(label),
                box=(x0, y0, x1 + 1, y1 + 1),
                centre=(columns / pixels + 0.5, rows / pixels + 0.5),
                depth_m=depth / max(measured, 1),
                hidden=hidden / outline,
                truncated=truncated / outline,
            )
        )
    return numbers, things


def draw_outlines(
    numbers: np.ndarray, thing: Thing, strength: float, random: np.random.Generator
) -> list[Outline]:
    """What a detector draws around a thing: one mask, or one for each of two parts.

    Args:
        numbers: the thing at each pixel, int32 [H, W].
        thing: which.
        strength: of all errors; 0 gives the exact mask and box.
        random: draws the errors.
    """
    unit = strength * max(1.0, numbers.shape[1] / 320)
    pad = int(np.ceil(unit * (3 * _RAGGED_PX + _BLEED_PX)))
    x0, y0, x1, y1 = thing.box
    left, top = max(x0 - pad, 0), max(y0 - pad, 0)
    window = numbers[top : y1 + pad, left : x1 + pad]
    mask = window == thing.number
    split, merged, box_only = random.random(3) < strength * np.array([_SPLIT, _MERGED, _BOX_ONLY])
    if merged:
        mask = mask | (window == _largest_other(window, thing.number))
    parts = _halves(mask, random) if split else [mask]
    drawn = [_draw(part, left, top, numbers.shape, unit, strength, random) for part in parts]
    drawn = [_as_box(outline) for outline in drawn] if box_only else drawn
    return [outline for outline in drawn if outline.mask.any()]


def _largest_other(window: np.ndarray, number: int) -> int:
    counts = np.bincount(window.reshape(-1))
    counts[[0, number]] = 0
    # Where there is no other, the thing itself.
    return int(counts.argmax()) or number


def _halves(mask: np.ndarray, random: np.random.Generator) -> list[np.ndarray]:
    """Both sides of a line through somewhere near the mask's middle; those that are not empty."""
    height, width = mask.shape
    angle, along = random.uniform(0, np.pi), random.uniform(0.3, 0.7, 2)
    rows, columns = np.ogrid[:height, :width]
    across = (columns - along[0] * width) * np.cos(angle) + (rows - along[1] * height) * np.sin(
        angle
    )
    return [part for part in (mask & (across > 0), mask & (across <= 0)) if part.any()]


def _draw(
    part: np.ndarray,
    left: int,
    top: int,
    shape: tuple[int, ...],
    unit: float,
    strength: float,
    random: np.random.Generator,
) -> Outline:
    """A part's box with jitter, and its mask with a ragged border, cut to the box."""
    rows, columns = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
    edges = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)
    sides = np.tile(edges[2:] - edges[:2], 2)
    jitter = strength * _BOX_JITTER * sides * random.standard_normal(4)
    limits = np.array([shape[1], shape[0], shape[1], shape[0]])
    offset = np.array([left, top, left, top])
    # The edges keep a pixel apart whatever the jitter.
    box = np.clip(edges + np.clip(jitter, (1 - sides) / 2, (sides - 1) / 2) + offset, 0, limits)
    mask = _ragged(part, unit, random) if unit > 0 else part
    x0, y0, x1, y1 = (box - offset).round().astype(int)
    inside = np.zeros_like(mask)
    inside[max(y0, 0) : y1, max(x0, 0) : x1] = True
    return Outline(box.astype(np.float32), left, top, mask & inside, False)


def _ragged(mask: np.ndarray, unit: float, random: np.random.Generator) -> np.ndarray:
    """The mask bled over one side, its border moved by low-frequency noise."""
    height, width = mask.shape
    angle, reach = random.uniform(0, 2 * np.pi), random.uniform(1, _BLEED_PX) * unit
    shift = np.array([[1, 0, reach * np.cos(angle)], [0, 1, reach * np.sin(angle)]])
    drawn = mask.astype(np.uint8)
    drawn = np.maximum(
        drawn, cv2.warpAffine(drawn, shift, (width, height), flags=cv2.INTER_NEAREST)
    )
    inward = cv2.distanceTransform(drawn, cv2.DIST_L2, 3)
    outward = cv2.distanceTransform(1 - drawn, cv2.DIST_L2, 3)
    grid = (max(2, round(height / (8 * unit))), max(2, round(width / (8 * unit))))
    noise = cv2.resize(random.standard_normal(grid), (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(inward - outward + unit * _RAGGED_PX * noise > 0)


def _as_box(outline: Outline) -> Outline:
    x0, y0, x1, y1 = outline.box.round().astype(int)
    return Outline(outline.box, x0, y0, np.ones((y1 - y0, x1 - x0), dtype=bool), True)


@numba.njit(cache=True)
def _components(labels: np.ndarray, depth_m: np.ndarray) -> tuple[np.ndarray, int]:
    """Connected pixels of one label and without a depth jump, numbered from 1 in raster order."""
    height, width = labels.shape
    parent = np.arange(height * width)
    for row in range(height):
        for column in range(width):
            here = row * width + column
            for there, step in ((here - 1, column > 0), (here - width, row > 0)):
                if not step:
                    continue
                r, c = there // width, there % width
                if labels[r, c] != labels[row, column]:
                    continue
                near = min(depth_m[r, c], depth_m[row, column])
                if near > 0 and abs(depth_m[r, c] - depth_m[row, column]) > _DEPTH_JUMP * near:
                    continue
                first, second = here, there
                while parent[first] != first:
                    parent[first] = parent[parent[first]]
                    first = parent[first]
                while parent[second] != second:
                    parent[second] = parent[parent[second]]
                    second = parent[second]
                parent[max(first, second)] = min(first, second)
    numbers = np.zeros((height, width), dtype=np.int32)
    count = 0
    for pixel in range(height * width):
        row, column = pixel // width, pixel % width
        if labels[row, column] == 0:
            continue
        # A root is the first pixel of its component, so it has its number already.
        root = pixel
        while parent[root] != root:
            root = parent[root]
        if root == pixel:
            count += 1
            numbers[row, column] = count
        else:
            numbers[row, column] = numbers[root // width, root % width]
    return numbers, count


@numba.njit(cache=True)
def _measure(
    numbers: np.ndarray, labels: np.ndarray, depth_m: np.ndarray, count: int
) -> np.ndarray:
    """By number, float64 [count + 1, 13]: sums, label, box.

    Sums are of pixels, columns, rows, depth, measured, outline, hidden and truncated; the box is
    the first and last column and row.
    """
    height, width = numbers.shape
    sums = np.zeros((count + 1, 13))
    sums[:, 9:11] = np.inf
    for row in range(height):
        for column in range(width):
            number = numbers[row, column]
            if number == 0:
                continue
            thing, z = sums[number], depth_m[row, column]
            thing[0] += 1
            thing[1] += column
            thing[2] += row
            thing[3] += z
            thing[4] += z > 0
            thing[8] = labels[row, column]
            thing[9], thing[10] = min(thing[9], column), min(thing[10], row)
            thing[11], thing[12] = max(thing[11], column), max(thing[12], row)
            for r, c in (
                (row - 1, column),
                (row + 1, column),
                (row, column - 1),
                (row, column + 1),
            ):
                if r < 0 or c < 0 or r == height or c == width:
                    thing[5] += 1
                    thing[7] += 1
                elif numbers[r, c] != number:
                    thing[5] += 1
                    # A surface in front, rather than one that it stands on.
                    thing[6] += 0 < depth_m[r, c] < z * (1 - _DEPTH_JUMP / 2)
    return sums
