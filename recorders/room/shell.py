"""Floor, ceiling and the four walls."""

from __future__ import annotations

from recorders.room.colors import Colors
from recorders.room.materials import BRICK, PALETTE, PLAIN, PLANKS, STRIPES, TILES, Material, Rgb
from recorders.room.shapes import Primitive, Vector, rectangle

ROOM_M: Vector = (6.0, 5.0, 2.7)
"""Inner size; the room is the box from the origin to here."""

_X: Vector = (1.0, 0.0, 0.0)
_Y: Vector = (0.0, 1.0, 0.0)
_Z: Vector = (0.0, 0.0, 1.0)


def shell_parts(colors: Colors) -> list[tuple[str, str, Primitive]]:
    """Class, colour name and rectangle of the six inner faces; each looks into the room."""
    width, depth, height = ROOM_M
    x, y, z = width / 2, depth / 2, height / 2
    planks = Material((0.66, 0.47, 0.30), (0.50, 0.34, 0.20), PLANKS, 0.16)
    brick = Material((0.72, 0.42, 0.32), (0.80, 0.76, 0.70), BRICK, 0.30)
    tiles = Material((0.80, 0.86, 0.86), (0.62, 0.66, 0.66), TILES, 0.20)
    paper = Material((0.88, 0.84, 0.72), _tinted(PALETTE[colors.rug[0]]), STRIPES, 0.20)
    paint = Material((0.80, 0.84, 0.80), pattern=PLAIN)
    white = Material((0.92, 0.92, 0.90), pattern=PLAIN)
    back_x: Vector = (-1.0, 0.0, 0.0)
    back_y: Vector = (0.0, -1.0, 0.0)
    return [
        ("floor", "brown", rectangle(planks, (x, y, 0.0), _X, _Y, (width, depth))),
        ("ceiling", "white", rectangle(white, (x, y, height), _X, back_y, (width, depth))),
        ("wall", "white", rectangle(paper, (x, 0.0, z), back_x, _Z, (width, height))),
        ("wall", "red", rectangle(brick, (x, depth, z), _X, _Z, (width, height))),
        ("wall", "white", rectangle(paint, (0.0, y, z), _Y, _Z, (depth, height))),
        ("wall", "white", rectangle(tiles, (width, y, z), back_y, _Z, (depth, height))),
    ]


def _tinted(rgb: Rgb) -> Rgb:
    """A pale tint of a colour, for wallpaper."""
    r, g, b = (0.55 + 0.35 * channel for channel in rgb)
    return r, g, b
