"""Small things, lamps, plants and what hangs on walls; axes as in `furniture.py`."""

from __future__ import annotations

import math

from recorders.room.furniture import COUNTER_TOP_M, Parts
from recorders.room.materials import (
    CHECKER,
    COFFEE,
    DARK_METAL,
    LEAF,
    METAL,
    PALETTE,
    PAPER,
    PICTURE,
    SKY,
    SOIL,
    Material,
    fabric,
    plain,
    wood,
)
from recorders.room.shapes import Primitive, box, ellipsoid, frustum, rod

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
SHADE_GLOW = 0.55


def cup(color: str) -> Parts:
    """A mug of coffee 0.11 m high with a handle."""
    glaze = plain(color)
    return (
        frustum(glaze, (0.0, 0.0, 0.0), 0.038, 0.045, 0.105),
        frustum(COFFEE, (0.0, 0.0, 0.105), 0.038, 0.038, 0.002),
        box(glaze, (0.055, 0.0, 0.08), (0.04, 0.014, 0.014)),
        box(glaze, (0.055, 0.0, 0.03), (0.04, 0.014, 0.014)),
        box(glaze, (0.073, 0.0, 0.055), (0.014, 0.014, 0.064)),
    )


def book(color: str, thickness_m: float, height_m: float) -> Parts:
    """A book 0.16 m deep standing on its lower edge, its spine towards +y."""
    cover, depth_m = plain(color), 0.16
    inner_m = thickness_m - 0.008
    boards = [
        box(cover, (x * (thickness_m - 0.004) / 2, 0.0, height_m / 2), (0.004, depth_m, height_m))
        for x in (-1, 1)
    ]
    return (
        *boards,
        box(cover, (0.0, depth_m / 2 - 0.003, height_m / 2), (inner_m, 0.006, height_m)),
        box(PAPER, (0.0, -0.006, height_m / 2), (inner_m, depth_m - 0.02, height_m - 0.012)),
        box(PAPER, (0.0, depth_m / 2, 0.78 * height_m), (inner_m * 0.9, 0.002, 0.03)),
    )


def cushion(color: str) -> Parts:
    """A square cushion lying flat, 0.42 m wide and 0.14 m thick in its middle."""
    cloth = fabric(color)
    return (
        ellipsoid(cloth, (0.0, 0.0, 0.07), (0.23, 0.21, 0.07)),
        box(cloth, (0.0, 0.0, 0.07), (0.42, 0.38, 0.05)),
    )


def rug(color: str, second: str) -> Parts:
    """A checked rug 2.0 m by 1.5 m, 1 cm thick."""
    weave = Material(PALETTE[color], PALETTE[second], CHECKER, 0.25)
    return (box(weave, (0.0, 0.0, 0.005), (2.0, 1.5, 0.01)),)


def picture(variant: int, width_m: float, height_m: float) -> Parts:
    """A framed landscape; its origin is the middle of its back."""
    scene = Material((0.55, 0.72, 0.88), (0.20, 0.38, 0.18), PICTURE, float(variant))
    frame = wood("brown") if variant % 2 else plain("black")
    x, z, t = width_m / 2, height_m / 2, 0.04
    return (
        box(scene, (0.0, 0.01, 0.0), (width_m - t, 0.02, height_m - t)),
        *[box(frame, (s * (x - t / 2), 0.016, 0.0), (t, 0.032, height_m)) for s in (-1, 1)],
        *[box(frame, (0.0, 0.016, s * (z - t / 2)), (width_m - 2 * t, 0.032, t)) for s in (-1, 1)],
    )


def window(width_m: float, height_m: float) -> Parts:
    """A window with a cross of bars and a sill; its origin is the middle of its back."""
    glass = Material((0.80, 0.90, 1.0), (0.45, 0.62, 0.40), SKY, height_m, emission=1.0)
    frame = plain("white")
    x, z, t = width_m / 2, height_m / 2, 0.06
    return (
        box(glass, (0.0, 0.008, 0.0), (width_m - t, 0.016, height_m - t)),
        *[box(frame, (s * (x - t / 2), 0.02, 0.0), (t, 0.04, height_m)) for s in (-1, 1)],
        *[box(frame, (0.0, 0.02, s * (z - t / 2)), (width_m - 2 * t, 0.04, t)) for s in (-1, 1)],
        box(frame, (0.0, 0.017, 0.0), (0.04, 0.034, height_m - 2 * t)),
        box(frame, (0.0, 0.015, 0.12 * height_m), (width_m - 2 * t, 0.03, 0.035)),
        box(frame, (0.0, 0.05, -z - 0.015), (width_m + 0.1, 0.10, 0.03)),
    )


def door(color: str) -> Parts:
    """A closed door 0.86 m by 2.05 m in its frame, with panels and a handle."""
    leaf, frame = wood(color), plain("white")
    panels = [box(leaf, (0.0, 0.04, z), (0.56, 0.02, h)) for z, h in ((0.55, 0.7), (1.45, 0.8))]
    return (
        box(leaf, (0.0, 0.015, 1.0), (0.8, 0.03, 2.0)),
        *panels,
        *[box(frame, (0.43 * s, 0.03, 1.03), (0.06, 0.06, 2.06)) for s in (-1, 1)],
        box(frame, (0.0, 0.03, 2.03), (0.8, 0.06, 0.06)),
        rod(METAL, (0.34, 0.03, 1.02), (0.34, 0.075, 1.02), 0.012),
        rod(METAL, (0.35, 0.075, 1.02), (0.24, 0.075, 1.02), 0.011),
    )


def television() -> Parts:
    """A television 1.1 m wide on a foot, 0.72 m high; its foot is centred on the origin."""
    screen = Material((0.10, 0.13, 0.19), pattern=0)
    return (
        box(DARK_METAL, (0.0, 0.0, 0.01), (0.42, 0.2, 0.02)),
        box(DARK_METAL, (0.0, -0.02, 0.06), (0.08, 0.04, 0.08)),
        box(plain("black"), (0.0, 0.0, 0.41), (1.1, 0.05, 0.64)),
        box(screen, (0.0, 0.026, 0.42), (1.05, 0.004, 0.58)),
    )


def floor_lamp(color: str) -> Parts:
    """A standing lamp 1.65 m high."""
    shade = plain(color, SHADE_GLOW)
    return (
        frustum(DARK_METAL, (0.0, 0.0, 0.0), 0.16, 0.14, 0.03),
        frustum(DARK_METAL, (0.0, 0.0, 0.03), 0.015, 0.015, 1.35),
        frustum(shade, (0.0, 0.0, 1.35), 0.21, 0.13, 0.30),
    )


def table_lamp(color: str) -> Parts:
    """A bedside lamp 0.45 m high with a round body."""
    return (
        frustum(METAL, (0.0, 0.0, 0.0), 0.075, 0.07, 0.02),
        ellipsoid(plain("teal"), (0.0, 0.0, 0.11), (0.075, 0.075, 0.095)),
        frustum(METAL, (0.0, 0.0, 0.19), 0.012, 0.012, 0.08),
        frustum(plain(color, SHADE_GLOW), (0.0, 0.0, 0.25), 0.14, 0.09, 0.20),
    )


def pendant_lamp(color: str, cord_m: float) -> Parts:
    """A lamp that hangs from z = 0 on a cord."""
    return (
        frustum(DARK_METAL, (0.0, 0.0, -0.03), 0.05, 0.06, 0.03),
        frustum(DARK_METAL, (0.0, 0.0, -cord_m), 0.008, 0.008, cord_m - 0.03),
        frustum(plain(color, SHADE_GLOW), (0.0, 0.0, -cord_m - 0.22), 0.21, 0.06, 0.22),
    )


def plant(pot_color: str, height_m: float, leaves: int) -> Parts:
    """A plant in a pot: leaves fan out by the golden angle; 0.7 times as wide as high."""
    s = height_m
    parts: list[Primitive] = [
        frustum(plain(pot_color), (0.0, 0.0, 0.0), 0.10 * s, 0.14 * s, 0.26 * s),
        frustum(SOIL, (0.0, 0.0, 0.26 * s), 0.12 * s, 0.12 * s, 0.004),
    ]
    for i in range(leaves):
        turn, rise = i * GOLDEN_ANGLE, i / max(leaves - 1, 1)
        c, n = math.cos(turn), math.sin(turn)
        reach, tip = s * (0.20 - 0.14 * rise), s * (0.50 + 0.36 * rise)
        foot = (0.03 * s * c, 0.03 * s * n, 0.255 * s)
        leaf = (reach * c, reach * n, tip)
        parts.append(rod(LEAF, foot, leaf, 0.008))
        tilt_deg = -25.0 - 50.0 * rise
        turn_deg = (0.0, tilt_deg, math.degrees(turn))
        parts.append(ellipsoid(LEAF, leaf, (0.14 * s, 0.075 * s, 0.014), turn_deg))
    return tuple(parts)


def bin_with_lid(color: str) -> Parts:
    """A pedal bin 0.45 m high with a domed lid."""
    return (
        frustum(DARK_METAL, (0.0, 0.0, 0.0), 0.145, 0.145, 0.03),
        frustum(plain(color), (0.0, 0.0, 0.03), 0.14, 0.14, 0.33),
        frustum(DARK_METAL, (0.0, 0.0, 0.36), 0.146, 0.146, 0.025),
        ellipsoid(plain(color), (0.0, 0.0, 0.385), (0.138, 0.138, 0.06)),
        box(DARK_METAL, (0.0, 0.16, 0.015), (0.08, 0.05, 0.015)),
    )


def sink() -> Parts:
    """A basin 0.52 m by 0.38 m let into a counter, with a tap; z = 0 is the floor."""
    steel, top = METAL, COUNTER_TOP_M
    walls = [box(steel, (0.255 * s, 0.3, top - 0.09), (0.02, 0.39, 0.18)) for s in (-1, 1)]
    ends = [box(steel, (0.0, 0.3 + 0.185 * s, top - 0.09), (0.49, 0.02, 0.18)) for s in (-1, 1)]
    rim_m = top + 0.003
    rims = [box(steel, (0.268 * s, 0.3, rim_m), (0.046, 0.44, 0.006)) for s in (-1, 1)]
    lips = [box(steel, (0.0, 0.3 + 0.198 * s, rim_m), (0.49, 0.046, 0.006)) for s in (-1, 1)]
    return (
        *walls,
        *ends,
        *rims,
        *lips,
        box(steel, (0.0, 0.3, top - 0.175), (0.49, 0.35, 0.02)),
        frustum(DARK_METAL, (0.0, 0.3, top - 0.165), 0.03, 0.03, 0.003),
        rod(steel, (0.0, 0.115, top), (0.0, 0.115, top + 0.26), 0.016),
        rod(steel, (0.0, 0.10, top + 0.25), (0.0, 0.28, top + 0.25), 0.014),
        rod(steel, (0.0, 0.268, top + 0.25), (0.0, 0.268, top + 0.19), 0.013),
    )
