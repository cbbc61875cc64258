"""Dealing colours to objects, so that colour alone never tells what a thing is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.room.materials import ACCENTS


@dataclass(frozen=True)
class Colors:
    """Names of palette colours by place; whatever the seed, every pair of `deal_colors` holds."""

    chairs: tuple[str, ...]
    sofa: str
    sofa_cushions: tuple[str, ...]
    pillows: tuple[str, ...]
    cups: tuple[str, ...]
    table_books: tuple[str, ...]
    pots: tuple[str, ...]
    rug: tuple[str, str]
    blanket: str
    bin: str
    floor_lamp: str
    pendant: str
    table: str
    coffee_table: str
    tv_cabinet: str
    nightstand: str
    counter: str
    refrigerator: str
    door: str


def deal_colors(rng: np.random.Generator) -> Colors:
    """Deal the accents: each of the first four to one chair and to things of other classes.

    Whatever the seed, a cushion, a cup, a book and the bin share their colour with a chair; the
    chairs have four colours, the sofa's cushions three.
    """
    a, b, c, d, e, f, g, h = (str(name) for name in rng.permutation(ACCENTS))
    return Colors(
        chairs=(a, b, c, d),
        sofa=str(rng.choice(["grey", g])),
        sofa_cushions=(a, e, b),
        pillows=("white", c),
        cups=(a, c, "white", f),
        table_books=(b, e),
        pots=(h, "brown"),
        rug=(e, "white"),
        blanket=f,
        bin=d,
        floor_lamp=str(rng.choice(["white", "yellow", "orange"])),
        pendant=str(rng.choice(["white", "grey", "yellow"])),
        table="brown",
        coffee_table="white",
        tv_cabinet="grey",
        nightstand="white",
        counter=str(rng.choice(["white", "teal", "green"])),
        refrigerator=str(rng.choice(["white", "grey", "red"])),
        door=str(rng.choice(["brown", "white"])),
    )
