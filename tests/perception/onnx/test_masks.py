"""Masks against plain full-size arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

from proground_log.perception.onnx.letterbox import Letterbox
from proground_log.perception.onnx.masks import (
    LEAST_FIT,
    Segments,
    assign_owners,
    best_segments,
    covers_pixels,
    mask_in_box,
    pixels_of,
    without_rims,
)

SIDE = 64
SIZES = st.integers(8, 150)


def some_segments(letterbox: Letterbox, boxes: np.ndarray, seed: int = 0) -> Segments:
    random = np.random.default_rng(seed)
    cells = letterbox.side // 4
    smooth = [gaussian_filter(random.normal(size=(cells, cells)), 1.5) for _ in range(32)]
    return Segments(
        boxes=boxes.astype(np.float32),
        coefficients=random.normal(size=(len(boxes), 32)).astype(np.float32),
        prototypes=np.stack(smooth).astype(np.float32),
        letterbox=letterbox,
    )


def drawn(letterbox: Letterbox, pictures: np.ndarray, boxes: np.ndarray | None = None) -> Segments:
    """Segments with these masks, bool [M, S/4, S/4], M at most 32."""
    prototypes = np.zeros((32, *pictures.shape[1:]), np.float32)
    prototypes[: len(pictures)] = np.where(pictures, 1, -1)
    whole = np.tile([0, 0, letterbox.width, letterbox.height], (len(pictures), 1))
    return Segments(
        boxes=(whole if boxes is None else boxes).astype(np.float32),
        coefficients=np.eye(len(pictures), 32, dtype=np.float32),
        prototypes=prototypes,
        letterbox=letterbox,
    )


def random_boxes(random: np.random.Generator, count: int, width: int, height: int) -> np.ndarray:
    corners = np.sort(random.random((count, 2, 2)), axis=1) * (width, height)
    return corners.reshape(count, 4).astype(np.float32)


def full_mixture(segments: Segments, number: int) -> np.ndarray:
    """The mixture at each pixel of the image, in double precision."""
    mixture = np.tensordot(
        segments.coefficients[number].astype(np.float64), segments.prototypes.astype(np.float64), 1
    )
    box = segments.letterbox
    columns = ((np.arange(box.width) + 0.5) * box.inner_size[0] / box.width + box.padding[0]) / 4
    rows = ((np.arange(box.height) + 0.5) * box.inner_size[1] / box.height + box.padding[1]) / 4
    at = np.meshgrid(rows - 0.5, columns - 0.5, indexing="ij")
    return map_coordinates(mixture, at, order=1, mode="nearest")


def inside(box: np.ndarray, width: int, height: int) -> np.ndarray:
    x, y = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
    return (box[0] <= x) & (x < box[2]) & (box[1] <= y) & (y < box[3])


@given(SIZES, SIZES, st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_a_mask_is_the_interpolated_mixture_in_both_boxes(w: int, h: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    own, box = random_boxes(random, 2, w, h)
    segments = some_segments(Letterbox(w, h, SIDE), own[None], seed)
    (rows, columns), mask = mask_in_box(segments, 0, box)
    found = np.zeros((h, w), bool)
    found[rows, columns] = mask
    mixture = full_mixture(segments, 0)
    expected = (mixture > 0) & inside(own, w, h) & inside(box, w, h)
    is_clear = np.abs(mixture) > 1e-4
    np.testing.assert_array_equal(found[is_clear], expected[is_clear])
    assert is_clear.mean() > 0.95


@given(SIZES, SIZES, st.integers(0, 1000))
def test_pixels_of_a_box_are_those_with_their_centre_in_it(w: int, h: int, seed: int) -> None:
    boxes = random_boxes(np.random.default_rng(seed), 5, w, h)
    boxes[0] = np.floor(boxes[0])
    for box, is_covering in zip(boxes, covers_pixels(boxes), strict=True):
        image = np.zeros((h, w), bool)
        image[pixels_of(box)] = True
        np.testing.assert_array_equal(image, inside(box, w, h))
        assert is_covering == image.any()


@given(st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_the_best_mask_is_that_of_areas_counted_one_by_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    letterbox = Letterbox(80, 60, 80)  # A cell of the prototypes is 4 pixels wide.
    pictures = np.stack([gaussian_filter(random.normal(size=(20, 20)), 2) > 0 for _ in range(6)])
    # Edges on whole pixels, so that counting pixels gives the areas exactly.
    own = np.round(random_boxes(random, 6, 80, 60))
    own[:, 2:] = np.minimum(np.maximum(own[:, 2:], own[:, :2] + 1), (80, 60))
    own[:, :2] = np.minimum(own[:, :2], own[:, 2:] - 1)
    boxes = np.round(random_boxes(random, 8, 80, 60))
    boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2] + 1)
    segments = drawn(letterbox, pictures, own)
    masks = [
        picture.repeat(4, 0).repeat(4, 1)[10:70] & inside(box, 80, 60)
        for picture, box in zip(pictures, own, strict=True)
    ]
    fits = np.zeros((8, 6))
    for n, box in enumerate(boxes):
        area = np.prod(box[2:] - box[:2])
        for m, mask in enumerate(masks):
            shared = (mask & inside(box, 80, 60)).sum()
            fits[n, m] = shared / (area + mask.sum() - shared)
    expected = np.where(fits.max(axis=1) < LEAST_FIT, -1, fits.argmax(axis=1))
    is_clear = np.abs(fits.max(axis=1) - LEAST_FIT) > 1e-9
    np.testing.assert_array_equal(best_segments(boxes, segments)[is_clear], expected[is_clear])


def test_of_equal_masks_the_lower_number_is_chosen_and_none_below_the_limit() -> None:
    letterbox = Letterbox(64, 64, 64)
    picture = np.zeros((16, 16), bool)
    picture[4:8, 4:8] = True  # Pixels 16 to 32.
    segments = drawn(letterbox, np.stack([picture, picture]))
    side = 16 / np.sqrt(0.3)
    boxes = np.float32(
        [
            [16, 16, 32, 32],
            [16, 16, 16 + side - 0.1, 16 + side - 0.1],
            [16, 16, 16 + side + 0.1, 16 + side + 0.1],
            [40, 40, 60, 60],
        ]
    )
    assert best_segments(boxes, segments).tolist() == [0, 0, -1, -1]


def test_without_segments_boxes_stand_in() -> None:
    letterbox = Letterbox(64, 64, 64)
    segments = drawn(letterbox, np.zeros((0, 16, 16), bool))
    boxes = np.float32([[10, 10, 20, 20]])
    choice = best_segments(boxes, segments)
    owner, is_box = assign_owners(boxes, segments, choice)
    expected = np.zeros((64, 64), np.uint16)
    expected[11:19, 11:19] = 1
    np.testing.assert_array_equal(owner, expected)
    assert is_box.tolist() == [True]


def test_no_regions() -> None:
    segments = some_segments(Letterbox(64, 48, 64), np.zeros((0, 4)))
    owner, is_box = assign_owners(segments.boxes, segments, np.zeros(0, np.int64))
    assert owner.shape == (48, 64)
    assert owner.dtype == np.uint16
    assert not owner.any()
    assert is_box.shape == (0,)


@given(st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_owners_are_those_of_whole_masks_painted_one_over_another(seed: int) -> None:
    random = np.random.default_rng(seed)
    boxes = random_boxes(random, 6, 90, 70)
    segments = some_segments(Letterbox(90, 70, SIDE), boxes, seed)
    choice = np.array([0, 1, -1, 3, 4, 5])
    owner, is_box = assign_owners(boxes, segments, choice)
    expected, unclear = np.zeros((70, 90), np.uint16), np.zeros((70, 90), bool)
    for number in range(5, -1, -1):
        here = inside(boxes[number], 90, 70)
        mixture = full_mixture(segments, number)
        mask = here & (mixture > 0)
        if choice[number] < 0 or not mask.any():
            mask = here
            assert is_box[number]
        else:
            assert not is_box[number]
        expected[mask] = number + 1
        unclear |= np.abs(mixture) < 1e-4
    # Where rounding decides, the pixels around may lose their owner too.
    is_clear = ~maximum_filter(unclear, 3)
    np.testing.assert_array_equal(owner[is_clear], without_rims(expected)[is_clear])
    assert is_clear.mean() > 0.9


def test_a_mask_without_a_pixel_gives_way_to_the_box() -> None:
    letterbox = Letterbox(64, 64, 64)
    segments = drawn(letterbox, np.zeros((1, 16, 16), bool))
    owner, is_box = assign_owners(np.float32([[10, 10, 20, 20]]), segments, np.array([0]))
    assert is_box.tolist() == [True]
    assert (owner == 1).sum() == 8 * 8


@pytest.mark.parametrize("seed", range(5))
def test_rims_belong_to_nobody(seed: int) -> None:
    random = np.random.default_rng(seed)
    owner = (gaussian_filter(random.normal(size=(40, 50)), 3) * 20 + 2).clip(0, 5).astype(np.uint16)
    expected = owner.copy()
    for y in range(40):
        for x in range(50):
            around = owner[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            if (around != owner[y, x]).any():
                expected[y, x] = 0
    assert 0 < (expected > 0).sum() < (owner > 0).sum()
    np.testing.assert_array_equal(without_rims(owner), expected)
