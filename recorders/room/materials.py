"""What surfaces are made of: named colours and procedural patterns."""

from __future__ import annotations

from dataclasses import dataclass

PLAIN, WOOD, PLANKS, CHECKER, BRICK, STRIPES, TILES, FABRIC, PICTURE, SKY = range(10)
"""Patterns; `texture.py` draws them."""

Rgb = tuple[float, float, float]

PALETTE: dict[str, Rgb] = {
    "red": (0.74, 0.10, 0.09),
    "green": (0.16, 0.50, 0.20),
    "blue": (0.12, 0.28, 0.68),
    "yellow": (0.92, 0.74, 0.12),
    "orange": (0.92, 0.45, 0.08),
    "purple": (0.44, 0.18, 0.56),
    "teal": (0.05, 0.52, 0.52),
    "pink": (0.92, 0.52, 0.62),
    "white": (0.90, 0.90, 0.88),
    "black": (0.07, 0.07, 0.08),
    "grey": (0.47, 0.48, 0.50),
    "brown": (0.52, 0.33, 0.18),
}
"""sRGB of the colours that objects are named after, 0 to 1."""

ACCENTS = ("red", "green", "blue", "yellow", "orange", "purple", "teal", "pink")
"""The colours that a seed deals out."""


@dataclass(frozen=True)
class Material:
    """A surface.

    Args:
        rgb: main colour, sRGB 0 to 1.
        second_rgb: the pattern's other colour.
        pattern: one of the patterns of this file.
        scale_m: size of the pattern's repeat.
        emission: light that the surface gives off, as a multiple of its colour.
    """

    rgb: Rgb
    second_rgb: Rgb = (0.0, 0.0, 0.0)
    pattern: int = PLAIN
    scale_m: float = 0.1
    emission: float = 0.0


def plain(color: str, emission: float = 0.0) -> Material:
    """Paint in a colour of the palette."""
    return Material(PALETTE[color], emission=emission)


def fabric(color: str) -> Material:
    """Cloth in a colour of the palette, with light and shade some centimetres wide."""
    return Material(PALETTE[color], pattern=FABRIC, scale_m=0.06)


def wood(color: str = "brown") -> Material:
    """Wood with grain along the part's longest side; "white" and accents look like stain."""
    r, g, b = PALETTE[color]
    return Material((r, g, b), (r * 0.68, g * 0.64, b * 0.58), WOOD, 0.07)


METAL = Material((0.66, 0.67, 0.70))
DARK_METAL = Material((0.22, 0.22, 0.24))
SOIL = Material((0.16, 0.11, 0.08))
PAPER = Material((0.90, 0.87, 0.78))
LEAF = Material((0.20, 0.46, 0.16), pattern=FABRIC, scale_m=0.08)
COFFEE = Material((0.20, 0.12, 0.07))
