"""The colours of all that has none of its own: labels, prompts, curves."""

from __future__ import annotations

import cv2
import numpy as np

CURVE_COLORS = (
    (86, 180, 233),
    (230, 159, 0),
    (0, 190, 135),
    (240, 228, 66),
    (213, 94, 0),
    (204, 121, 167),
    (110, 130, 255),
)
"""Okabe and Ito's palette, told apart by people with colour-blindness too, fit for black."""
TOTAL_COLOR = (255, 255, 255)
NOTHING_COLOR = (84, 87, 94)
"""Background, and what is without supervision."""


def label_colors(count: int) -> np.ndarray:
    """RGB colours of the labels 0 to count - 1, uint8 [count, 3]; label 0 is black.

    Neighbouring labels are a golden angle apart in hue, with three levels of brightness.
    """
    labels = np.arange(count)
    hue = (labels * 0.61803398875) % 1.0 * 180
    saturation = np.full(count, 190)
    value = 255 - 55 * (labels % 3)
    hsv = np.stack([hue, saturation, value], axis=-1).astype(np.uint8)
    colors = cv2.cvtColor(hsv[None], cv2.COLOR_HSV2RGB)[0]
    colors[0] = 0
    return colors
