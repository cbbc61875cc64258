"""Names of colours, from the colours that a map has itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from skimage.color import rgb2lab

COLORS = (
    *("black", "grey", "white", "brown", "red", "orange", "yellow", "green", "teal", "blue"),
    *("purple", "pink"),
)
"""What colours can be called: the basic colour terms of English (Berlin and Kay, 1969) and teal."""
OTHER_WORDS: Mapping[str, str] = {
    "gray": "grey",
    "silver": "grey",
    "violet": "purple",
    "turquoise": "teal",
    "cyan": "teal",
    "beige": "brown",
}
"""Other words for them."""
SHARE = 0.3
"""A thing is called by a colour that so much of it has: the seat of a chair that has brown legs."""

_OFFSET = 16.0
"""L* + 16, a* and b* all go with the cube root of the light (CIE 1976), so that ratios of them do
not depend on it."""
_WHITE_PERCENTILE = 95
"""The light is judged by what is brightest in the map, but for lamps and reflections."""
_NEUTRAL = 0.12
"""Chroma below so much of L* + 16 is black, grey or white."""
_BLACK, _WHITE = 0.42, 0.76
"""Bounds of grey, as a share of the brightest L* + 16; white in half the light has 0.79."""
_HUE_ENDS_DEG = (18, 47, 74, 108, 168, 222, 308, 340, 360)
_HUES = ("pink", "red", "orange", "yellow", "green", "teal", "blue", "purple", "pink")
"""The hues and where each ends, as an angle in the a* b* plane."""
_DARK_WARM = 0.62
"""An orange or yellow that is darker than so much of the brightest L* + 16 is brown."""


def light_of(colors: np.ndarray) -> float:
    """How bright what is white looks in a map, L* + 16, from its colours uint8 [V, 3] RGB."""
    return float(np.percentile(_lab(colors)[:, 0] + _OFFSET, _WHITE_PERCENTILE))


def color_names(colors: np.ndarray, light: float) -> np.ndarray:
    """What people call colours.

    Hue and saturation do not change as light gets dimmer, so that only black, grey and white, and
    brown against orange, are judged by the light.

    Args:
        colors: uint8 [N, 3] RGB, sRGB.
        light: of `light_of`.

    Returns:
        int64 [N], numbers in `COLORS`.
    """
    lab = _lab(colors)
    level = lab[:, 0] + _OFFSET
    saturation = np.hypot(lab[:, 1], lab[:, 2]) / level
    brightness = level / light
    hue_deg = np.degrees(np.arctan2(lab[:, 2], lab[:, 1])) % 360
    place = np.searchsorted(np.array(_HUE_ENDS_DEG), hue_deg).clip(max=len(_HUES) - 1)
    names = np.array(_HUES)[place]
    warm = np.isin(names, ("orange", "yellow"))
    names[warm & (brightness < _DARK_WARM)] = "brown"
    gray = np.where(brightness < _BLACK, "black", np.where(brightness < _WHITE, "grey", "white"))
    names = np.where(saturation < _NEUTRAL, gray, names)
    return np.array([COLORS.index(name) for name in names.tolist()], np.int64)


def _lab(colors: np.ndarray) -> np.ndarray:
    return np.asarray(rgb2lab(colors.reshape(-1, 1, 3)), np.float64).reshape(-1, 3)
