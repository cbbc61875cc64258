"""The square image that a YOLO network looks at, and the way back to the camera's pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

PAD_VALUE = 114
"""Grey around the image, of 255: what YOLO networks are trained with."""


@dataclass(frozen=True)
class Letterbox:
    """Where an image lies in a square: as large as fits, aspect kept, in the middle.

    Args:
        width, height: size of the image in pixels.
        side: of the square, in pixels.
    """

    width: int
    height: int
    side: int

    @cached_property
    def inner_size(self) -> tuple[int, int]:
        """Width and height of the image within the square."""
        scale = min(self.side / self.width, self.side / self.height)
        return max(1, round(self.width * scale)), max(1, round(self.height * scale))

    @cached_property
    def scale(self) -> np.ndarray:
        """Pixels of the square by pixel of the image along x and y, float32 [2].

        They differ by what rounding to whole pixels takes.
        """
        size = np.array([self.width, self.height], np.float32)
        return np.array(self.inner_size, np.float32) / size

    @cached_property
    def padding(self) -> tuple[int, int]:
        """Pixels of grey left of the image and above it."""
        width, height = self.inner_size
        return (self.side - width) // 2, (self.side - height) // 2

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The square of an image uint8 [H, W, 3] RGB: float32 [1, 3, S, S] in [0, 1]."""
        (left, top), (width, height) = self.padding, self.inner_size
        image = cv2.resize(image, self.inner_size, interpolation=cv2.INTER_LINEAR)
        square = np.full((1, 3, self.side, self.side), PAD_VALUE / 255, np.float32)
        for channel, plane in enumerate(square[0, :, top : top + height, left : left + width]):
            np.divide(cv2.extractChannel(image, channel), np.float32(255), out=plane)
        return square

    def boxes_in_image(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes [N, 4] of the square (x0 y0 x1 y1) in pixels of the image, clipped to it."""
        shift = np.tile(np.array(self.padding, np.float32), 2)
        edges = np.array([self.width, self.height] * 2, np.float32)
        return np.clip((boxes - shift) / np.tile(self.scale, 2), 0, edges)
