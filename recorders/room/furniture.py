"""Large furniture, each piece in its own axes.

The floor is z = 0 and the front looks towards +y. Pieces that stand against a wall have their
back in the plane y = 0; the others are centred on the origin.
"""

from __future__ import annotations

from recorders.room.materials import (
    DARK_METAL,
    FABRIC,
    METAL,
    PALETTE,
    Material,
    fabric,
    plain,
    wood,
)
from recorders.room.shapes import Primitive, box, ellipsoid, frustum, rod

Parts = tuple[Primitive, ...]


def chair(color: str) -> Parts:
    """A dining chair 0.42 m square: four legs, a seat 0.46 m high, a back of two rails."""
    frame, seat = wood("brown"), plain(color)
    legs = [
        box(frame, (0.18 * x, 0.18 * y, 0.21), (0.04, 0.04, 0.42)) for x in (-1, 1) for y in (-1, 1)
    ]
    posts = [box(frame, (0.19 * x, -0.21, 0.67), (0.035, 0.035, 0.46)) for x in (-1, 1)]
    return (
        *legs,
        *posts,
        box(seat, (0.0, 0.0, 0.44), (0.43, 0.43, 0.04)),
        box(seat, (0.0, -0.21, 0.81), (0.345, 0.025, 0.17)),
        box(seat, (0.0, -0.21, 0.60), (0.345, 0.02, 0.07)),
    )


def dining_table(color: str) -> Parts:
    """A table 0.8 m (x) by 1.3 m (y), 0.75 m high."""
    material = wood(color)
    legs = [
        box(material, (0.355 * x, 0.605 * y, 0.355), (0.06, 0.06, 0.71))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    aprons = [box(material, (0.355 * x, 0.0, 0.67), (0.025, 1.15, 0.08)) for x in (-1, 1)]
    return (*legs, *aprons, box(material, (0.0, 0.0, 0.73), (0.8, 1.3, 0.04)))


def coffee_table(color: str) -> Parts:
    """A low table 1.0 m by 0.55 m, 0.42 m high, with a shelf under its top."""
    material = wood(color)
    legs = [
        rod(DARK_METAL, (0.45 * x, 0.23 * y, 0.0), (0.41 * x, 0.2 * y, 0.385), 0.018)
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    shelf = box(material, (0.0, 0.0, 0.16), (0.8, 0.38, 0.02))
    return (*legs, shelf, box(material, (0.0, 0.0, 0.40), (1.0, 0.55, 0.04)))


def sofa(color: str) -> Parts:
    """A three-seat sofa 1.9 m wide and 0.88 m deep; its seat is 0.44 m high."""
    cloth = fabric(color)
    r, g, b = PALETTE[color]
    seat = Material((r * 1.12, g * 1.12, b * 1.12), pattern=FABRIC, scale_m=0.05)
    feet = [
        frustum(DARK_METAL, (0.85 * x, 0.44 + 0.34 * y, 0.0), 0.02, 0.03, 0.1)
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    seats = [box(seat, (0.52 * i, 0.53, 0.37), (0.51, 0.66, 0.14)) for i in (-1, 0, 1)]
    backs = [
        box(seat, (0.52 * i, 0.235, 0.62), (0.5, 0.13, 0.40), (8.0, 0.0, 0.0)) for i in (-1, 0, 1)
    ]
    arms = [box(cloth, (0.865 * x, 0.44, 0.35), (0.17, 0.88, 0.5)) for x in (-1, 1)]
    rolls = [rod(cloth, (0.865 * x, 0.0, 0.60), (0.865 * x, 0.88, 0.60), 0.085) for x in (-1, 1)]
    body = box(cloth, (0.0, 0.44, 0.2), (1.6, 0.84, 0.2))
    rest = box(cloth, (0.0, 0.09, 0.5), (1.6, 0.18, 0.66))
    return (*feet, body, rest, *seats, *backs, *arms, *rolls)


def bed(color: str) -> Parts:
    """A bed 1.5 m by 2.05 m with its headboard at the back; the mattress top is 0.5 m high."""
    frame = wood("brown")
    posts = [
        box(frame, (0.71 * x, y, 0.075), (0.07, 0.07, 0.15)) for x in (-1, 1) for y in (0.12, 1.95)
    ]
    return (
        *posts,
        box(frame, (0.0, 1.04, 0.22), (1.5, 1.98, 0.16)),
        box(frame, (0.0, 0.03, 0.55), (1.54, 0.06, 0.9)),
        box(plain("white"), (0.0, 1.05, 0.40), (1.44, 1.94, 0.2)),
        box(fabric(color), (0.0, 1.41, 0.405), (1.53, 1.28, 0.24)),
        box(fabric("white"), (0.0, 0.86, 0.43), (1.52, 0.2, 0.21)),
    )


def bookshelf() -> Parts:
    """Open shelves 1.1 m wide, 0.3 m deep and 1.9 m high; boards as `SHELF_TOPS_M` says."""
    material = wood("brown")
    sides = [box(material, (0.535 * x, 0.15, 0.95), (0.03, 0.30, 1.9)) for x in (-1, 1)]
    boards = [box(material, (0.0, 0.15, z - 0.0125), (1.04, 0.29, 0.025)) for z in SHELF_TOPS_M]
    back = box(wood("white"), (0.0, 0.006, 0.95), (1.04, 0.012, 1.88))
    return (*sides, *boards, back, box(material, (0.0, 0.15, 1.885), (1.04, 0.29, 0.025)))


SHELF_TOPS_M = (0.08, 0.45, 0.82, 1.19, 1.56)
"""Height of the upper face of each board that carries something."""


def cabinet(color: str, width_m: float, depth_m: float, height_m: float, doors: int) -> Parts:
    """A closed cabinet against the wall, on a plinth, with doors side by side and knobs."""
    body, front = wood(color), wood(color)
    pitch_m = width_m / doors
    parts = [
        box(DARK_METAL, (0.0, depth_m / 2 - 0.02, 0.03), (width_m - 0.06, depth_m - 0.06, 0.06)),
        box(
            body,
            (0.0, depth_m / 2 - 0.01, 0.06 + (height_m - 0.06) / 2),
            (width_m, depth_m - 0.02, height_m - 0.06),
        ),
    ]
    for i in range(doors):
        x = (i + 0.5) * pitch_m - width_m / 2
        tall_m = height_m - 0.12
        parts.append(
            box(front, (x, depth_m - 0.01, 0.09 + tall_m / 2), (pitch_m - 0.03, 0.025, tall_m))
        )
        knob_m = (x + 0.3 * pitch_m, depth_m + 0.015, 0.09 + 0.75 * tall_m)
        parts.append(ellipsoid(METAL, knob_m, (0.018, 0.018, 0.018)))
    return tuple(parts)


COUNTER_TOP_M = 0.9


def counter(color: str) -> Parts:
    """A kitchen counter 1.7 m wide and 0.6 m deep, with a hole for the sink around x = 0."""
    body, top = wood(color), Material((0.30, 0.29, 0.29), (0.42, 0.41, 0.40), FABRIC, 0.05)
    z = COUNTER_TOP_M - 0.02
    parts = [
        box(DARK_METAL, (0.0, 0.27, 0.04), (1.66, 0.50, 0.08)),
        box(body, (0.0, 0.285, 0.375), (1.7, 0.57, 0.59)),
        box(body, (-0.56, 0.285, 0.76), (0.58, 0.57, 0.2)),
        box(body, (0.56, 0.285, 0.76), (0.58, 0.57, 0.2)),
        box(body, (0.0, 0.55, 0.76), (0.54, 0.04, 0.2)),
        box(top, (-0.56, 0.3, z), (0.58, 0.6, 0.04)),
        box(top, (0.56, 0.3, z), (0.58, 0.6, 0.04)),
        box(top, (0.0, 0.05, z), (0.54, 0.1, 0.04)),
        box(top, (0.0, 0.55, z), (0.54, 0.1, 0.04)),
    ]
    for i in (-1.5, -0.5, 0.5, 1.5):
        x = 0.425 * i
        parts.append(box(body, (x, 0.575, 0.46), (0.395, 0.02, 0.70)))
        parts.append(rod(METAL, (x - 0.07, 0.60, 0.72), (x + 0.07, 0.60, 0.72), 0.012))
    return tuple(parts)


def refrigerator(color: str) -> Parts:
    """A fridge with a freezer door above, 0.6 m wide, 0.62 m deep, 1.75 m high."""
    shell = plain(color)
    return (
        box(DARK_METAL, (0.0, 0.3, 0.02), (0.56, 0.52, 0.04)),
        box(shell, (0.0, 0.28, 0.895), (0.6, 0.56, 1.71)),
        box(shell, (0.0, 0.59, 0.60), (0.59, 0.06, 1.08)),
        box(shell, (0.0, 0.59, 1.45), (0.59, 0.06, 0.58)),
        rod(DARK_METAL, (0.22, 0.64, 0.75), (0.22, 0.64, 1.08), 0.015),
        rod(DARK_METAL, (0.22, 0.64, 1.22), (0.22, 0.64, 1.45), 0.015),
    )
