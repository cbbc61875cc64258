"""Colour names: of patches under bright and dim light, and of colours everybody knows."""

from __future__ import annotations

import numpy as np
import pytest

from proground_log.query.attributes import COLORS, OTHER_WORDS, color_names, light_of
from recorders.room.materials import PALETTE


def lit(rgb: tuple[float, float, float], light: float) -> np.ndarray:
    """An sRGB colour, 0 to 1, under less light, uint8 [3]; IEC 61966-2-1."""
    srgb = np.array(rgb)
    linear = light * np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    dim = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (255 * dim).round().astype(np.uint8)


@pytest.mark.parametrize("light", [1.0, 0.5, 0.25, 0.12])
def test_patches_keep_their_names_in_dim_light(light: float) -> None:
    patches = np.stack([lit(rgb, light) for rgb in PALETTE.values()])
    walls = np.tile(lit(PALETTE["white"], light), (30, 1))
    names = color_names(patches, light_of(np.concatenate([patches, walls])))
    assert [COLORS[name] for name in names] == list(PALETTE)


@pytest.mark.parametrize("name", sorted(PALETTE))
def test_a_side_in_the_shade_keeps_the_name_of_its_hue(name: str) -> None:
    if name in ("black", "grey", "white", "orange", "yellow"):
        pytest.skip("in the shade these do look like others")
    light = light_of(np.tile(lit(PALETTE["white"], 1.0), (30, 1)))
    found = color_names(lit(PALETTE[name], 0.5)[None], light)
    assert COLORS[found[0]] == name


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((255, 0, 0), "red"),
        ((0, 128, 0), "green"),
        ((0, 0, 255), "blue"),
        ((255, 255, 0), "yellow"),
        ((255, 165, 0), "orange"),
        ((128, 0, 128), "purple"),
        ((0, 128, 128), "teal"),
        ((255, 192, 203), "pink"),
        ((165, 42, 42), "red"),
        ((139, 69, 19), "brown"),
        ((255, 255, 255), "white"),
        ((128, 128, 128), "grey"),
        ((0, 0, 0), "black"),
    ],
)
def test_the_web_s_colours_have_their_names(rgb: tuple[int, int, int], name: str) -> None:
    light = light_of(np.full((10, 3), 255, np.uint8))
    assert COLORS[color_names(np.array([rgb], np.uint8), light)[0]] == name


def test_other_words_mean_colours() -> None:
    assert set(OTHER_WORDS.values()) <= set(COLORS)
    assert not set(OTHER_WORDS) & set(COLORS)
