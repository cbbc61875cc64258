"""The furnished room: which object stands where, and in which colour."""

from __future__ import annotations

import numpy as np

from proground_log.streams import stream
from recorders.room import furniture, things
from recorders.room.colors import Colors, deal_colors
from recorders.room.furniture import COUNTER_TOP_M, SHELF_TOPS_M
from recorders.room.scene import Furnisher, Scene
from recorders.room.shell import ROOM_M, shell_parts


def furnish(seed: int) -> Scene:
    """The room of a seed: always the same objects, with other colours and small shifts."""
    room = Furnisher(stream(seed, "room placement"))
    colors = deal_colors(stream(seed, "room colors"))
    for class_name, color, part in shell_parts(colors):
        room.put(class_name, color, (part,), (0.0, 0.0, 0.0))
    _hang(room, colors)
    _sleep(room, colors)
    _shelve(room, stream(seed, "room books"))
    _lounge(room, colors)
    _dine(room, colors)
    _cook(room, colors)
    return room.scene()


def _hang(room: Furnisher, colors: Colors) -> None:
    """Doors, windows and pictures."""
    width, depth, height = ROOM_M
    room.put("door", colors.door, things.door(colors.door), (1.2, 0.0, 0.0))
    room.put("window", "white", things.window(1.3, 1.1), (0.0, 4.15, 1.72), -90)
    room.put("window", "white", things.window(1.3, 1.0), (width, 3.35, 1.62), 90)
    shift = room.jitter(0.05)
    room.put("picture", "brown", things.picture(1, 1.0, 0.7), (2.95 + shift, 0.0, 1.60))
    room.put("picture", "black", things.picture(2, 0.42, 0.56), (0.0, 2.62, 1.55), -90)
    room.put("picture", "brown", things.picture(3, 0.8, 0.6), (width, 1.35 + shift, 1.60), 90)
    room.put("picture", "black", things.picture(4, 0.5, 0.62), (2.3, depth, 1.55), 180)
    pendant = things.pendant_lamp(colors.pendant, 0.55)
    room.put("lamp", colors.pendant, pendant, (4.75, 1.35, height))


def _sleep(room: Furnisher, colors: Colors) -> None:
    """The bed in the north-west corner and what stands beside it."""
    y = 4.15 + room.jitter(0.02)
    room.put("bed", colors.blanket, furniture.bed(colors.blanket), (0.01, y, 0.0), -90)
    for side, color in zip((-0.34, 0.34), colors.pillows, strict=True):
        at_m = (0.36 + room.jitter(0.02), y + side, 0.5)
        room.put("cushion", color, things.cushion(color), at_m, 90 + room.jitter(5))
    y = 3.04 + room.jitter(0.02)
    stand = furniture.cabinet(colors.nightstand, 0.46, 0.42, 0.5, 1)
    room.put("cabinet", colors.nightstand, stand, (0.01, y, 0.0), -90)
    room.put("lamp", "white", things.table_lamp("white"), (0.19, y + 0.05, 0.5))
    at_m = (0.30, y - 0.155, 0.5)
    room.put("cup", colors.cups[0], things.cup(colors.cups[0]), at_m, 15 + room.jitter(10))


def _shelve(room: Furnisher, rng: np.random.Generator) -> None:
    """The bookshelf on the west wall, with rows of books, a plant and a cup."""
    y = 1.55
    room.put("bookshelf", "brown", furniture.bookshelf(), (0.005, y, 0.0), -90)
    names = ("red", "green", "blue", "yellow", "orange", "purple", "teal", "pink", "white", "black")
    for top_m, (start, count) in zip(SHELF_TOPS_M, SHELF_ROWS, strict=True):
        colors = rng.permutation(names)[:count]
        cursor = y - 0.5 + start
        for color in map(str, colors):
            thick_m, tall_m = float(rng.uniform(0.035, 0.06)), float(rng.uniform(0.20, 0.29))
            at_m = (0.165 + float(rng.uniform(0.0, 0.03)), cursor + thick_m / 2, top_m)
            room.put("book", color, things.book(color, thick_m, tall_m), at_m, -90)
            cursor += thick_m + 0.003
    room.put("plant", "green", things.plant("white", 0.3, 9), (0.17, y + 0.3, SHELF_TOPS_M[3]))
    room.put("plant", "green", things.plant("brown", 0.42, 11), (0.17, y + 0.22, 1.8975))


SHELF_ROWS = ((0.02, 8), (0.35, 8), (0.02, 9), (0.05, 6), (0.40, 7))
"""For each board: where its row of books starts, in metres, and how many stand there."""


def _lounge(room: Furnisher, colors: Colors) -> None:
    """Sofa, rug, low table and television in the middle."""
    room.put("lamp", colors.floor_lamp, things.floor_lamp(colors.floor_lamp), (0.38, 0.42, 0.0))
    x = 2.95 + room.jitter(0.02)
    room.put("sofa", colors.sofa, furniture.sofa(colors.sofa), (x, 0.02, 0.0))
    for along, color in zip((-0.51, -0.01, 0.49), colors.sofa_cushions, strict=True):
        at_m = (x + along + room.jitter(0.01), 0.475, 0.44)
        room.rest("cushion", color, things.cushion(color), at_m, (112.0, room.jitter(8), 0.0))
    room.put("rug", colors.rug[0], things.rug(*colors.rug), (2.92, 2.1, 0.0), room.jitter(1.5))
    x, y = 2.92 + room.jitter(0.03), 1.95 + room.jitter(0.03)
    low = furniture.coffee_table(colors.coffee_table)
    table = room.rest("table", colors.coffee_table, low, (x, y, RUG_TOP_M), (0.0, 0.0, 0.0))
    z = table.upper_m[2]
    room.put("cup", colors.cups[1], things.cup(colors.cups[1]), (x + 0.3, y - 0.08, z), 40)
    for level, color in enumerate(colors.table_books):
        lying = things.book(color, 0.045, 0.25 - 0.03 * level)
        at_m = (x - 0.15, y + 0.03, z + 0.045 * level)
        room.rest("book", color, lying, at_m, (0.0, 90.0, 20.0 + 25.0 * level + room.jitter(8)))
    cabinet = furniture.cabinet(colors.tv_cabinet, 1.5, 0.42, 0.5, 3)
    x = 3.3 + room.jitter(0.02)
    room.put("cabinet", colors.tv_cabinet, cabinet, (x, 4.99, 0.0), 180)
    room.put("television", "black", things.television(), (x, 4.78, 0.5), 180)
    room.put("plant", "green", things.plant(colors.pots[0], 1.2, 15), (4.68, 4.48, 0.0))


RUG_TOP_M = 0.01


def _dine(room: Furnisher, colors: Colors) -> None:
    """The table in the south-east with its four chairs."""
    x, y = 4.75, 1.35
    room.put("table", colors.table, furniture.dining_table(colors.table), (x, y, 0.0))
    seats = ((-0.50, -0.31, -90.0), (-0.46, 0.31, -90.0), (0.52, 0.06, 90.0), (0.02, 0.93, 180.0))
    for (right, back, turn), color in zip(seats, colors.chairs, strict=True):
        at_m = (x + right + room.jitter(0.01), y + back + room.jitter(0.01), 0.0)
        room.put("chair", color, furniture.chair(color), at_m, turn + room.jitter(3))
    places = ((-0.22, -0.28), (0.20, 0.22))
    for (right, back), color in zip(places, colors.cups[2:], strict=True):
        at_m = (x + right + room.jitter(0.03), y + back + room.jitter(0.03), 0.75)
        room.put("cup", color, things.cup(color), at_m, 60 + room.jitter(40))
    room.put("plant", "green", things.plant(colors.pots[1], 0.34, 9), (x, y, 0.75))
    room.put("plant", "green", things.plant("grey", 1.0, 13), (5.58, 0.42, 0.0))


def _cook(room: Furnisher, colors: Colors) -> None:
    """Counter, sink and fridge along the east wall, and a bin."""
    width = ROOM_M[0] - 0.005
    room.put("cabinet", colors.counter, furniture.counter(colors.counter), (width, 3.35, 0.0), 90)
    room.put("sink", "grey", things.sink(), (width, 3.35, 0.0), 90)
    room.put("cup", colors.cups[0], things.cup(colors.cups[0]), (5.75, 2.75, COUNTER_TOP_M), 30)
    fridge = furniture.refrigerator(colors.refrigerator)
    room.put("refrigerator", colors.refrigerator, fridge, (width, 4.58, 0.0), 90)
    room.put("bin", colors.bin, things.bin_with_lid(colors.bin), (5.72, 2.26, 0.0), 90)
