"""The square that a network sees, and the way back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from proground_log.perception.onnx.letterbox import Letterbox

SIDES = st.integers(1, 700)


@pytest.mark.parametrize(
    ("width", "height"), [(640, 480), (480, 640), (1296, 968), (100, 80), (640, 640), (641, 333)]
)
def test_a_rectangle_is_found_again_where_it_was(width: int, height: int) -> None:
    letterbox = Letterbox(width, height, 640)
    x0, y0, x1, y1 = width // 5, height // 4, width // 2, 3 * height // 4
    image = np.zeros((height, width, 3), np.uint8)
    image[y0:y1, x0:x1] = 255, 128, 0
    square = letterbox.apply(image)
    assert square.shape == (1, 3, 640, 640)
    assert square.dtype == np.float32
    rows, columns = np.nonzero((square[0, 0] > 0.5) & (square[0, 2] < 0.2))
    found = np.array([[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]], np.float32)
    pixels = 1 / letterbox.scale.min()  # A pixel of the square, in those of the image.
    expected = [[x0, y0, x1, y1]]
    np.testing.assert_allclose(
        letterbox.boxes_in_image(found), expected, atol=0.75 * max(1, pixels)
    )
    middle = square[0, :, (rows.min() + rows.max()) // 2, (columns.min() + columns.max()) // 2]
    np.testing.assert_allclose(middle, [1, 128 / 255, 0], atol=1e-6)


def test_around_the_image_it_is_grey() -> None:
    square = Letterbox(640, 480, 640).apply(np.zeros((480, 640, 3), np.uint8))
    grey = np.float32(114 / 255)
    assert (square[..., :80, :] == grey).all()
    assert (square[..., 560:, :] == grey).all()
    assert (square[..., 80:560, :] == 0).all()


def test_an_image_of_the_right_size_keeps_its_values() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    expected = image.astype(np.float32).transpose(2, 0, 1)[None] / np.float32(255)
    np.testing.assert_array_equal(Letterbox(64, 64, 64).apply(image), expected)


@given(SIDES, SIDES, st.sampled_from([64, 640]), st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_boxes_come_back(width: int, height: int, side: int, shares: list[float]) -> None:
    letterbox = Letterbox(width, height, side)
    size = np.tile(np.array([width, height]), 2)
    box = np.array(shares) * size
    inside = np.tile(letterbox.padding, 2) + box * np.tile(letterbox.inner_size, 2) / size
    assert (inside >= 0).all()
    assert (inside <= side).all()
    back = letterbox.boxes_in_image(inside[None].astype(np.float32))[0]
    np.testing.assert_allclose(back, box, atol=1e-4 * size.max() / min(letterbox.inner_size) + 1e-3)
    assert back.dtype == np.float32


@given(SIDES, SIDES)
def test_the_image_is_in_the_middle_and_as_large_as_fits(width: int, height: int) -> None:
    letterbox = Letterbox(width, height, 640)
    inner, padding = np.array(letterbox.inner_size), np.array(letterbox.padding)
    assert inner.max() == 640
    assert (np.abs(640 - inner - 2 * padding) <= 1).all()


def test_boxes_are_clipped_to_the_image() -> None:
    boxes = Letterbox(640, 480, 640).boxes_in_image(np.float32([[-10, 0, 700, 640]]))
    np.testing.assert_array_equal(boxes, [[0, 0, 640, 480]])
