"""Relations on a furnished corner whose boxes are known, and on the built-in room's true boxes."""

from __future__ import annotations

import numpy as np
import pytest

from proground_log.mapping.boxes import OrientedBox
from proground_log.query.relations import RELATIONS, WORDS
from recorders.room import RoomSource


def box(lower_m: tuple[float, ...], upper_m: tuple[float, ...]) -> OrientedBox:
    lower, upper = np.array(lower_m), np.array(upper_m)
    return OrientedBox((lower + upper) / 2, upper - lower, np.eye(3), 0.0)


CORNER = {
    "floor rug": box((0, 0, 0), (2, 2, 0.01)),
    "table": box((0.5, 0.5, 0), (1.5, 1.3, 0.75)),
    "cup": box((0.9, 0.8, 0.74), (1.0, 0.9, 0.84)),
    "bin": box((0.8, 0.8, 0), (1.1, 1.1, 0.35)),
    "lamp": box((0.9, 0.8, 1.6), (1.2, 1.1, 2.0)),
    "chair": box((2.2, 0.5, 0), (2.7, 1.0, 0.9)),
    "sofa": box((5, 0, 0), (7, 0.9, 0.8)),
    "cushion": box((5.2, 0.2, 0.42), (5.6, 0.6, 0.78)),
    "shelf": box((8, 0, 0), (9, 0.3, 2)),
    "book": box((8.4, 0.05, 1.2), (8.45, 0.25, 1.45)),
}
TRUE = {
    ("cup", "on", "table"),
    ("table", "on", "floor rug"),
    ("bin", "on", "floor rug"),
    ("floor rug", "under", "table"),
    ("floor rug", "under", "bin"),
    ("table", "under", "cup"),
    ("table", "under", "lamp"),
    ("bin", "under", "table"),
    ("bin", "in", "table"),
    ("lamp", "above", "table"),
    ("book", "in", "shelf"),
    ("book", "on", "shelf"),
    ("cushion", "in", "sofa"),
    ("cushion", "on", "sofa"),
}


@pytest.mark.parametrize("relation", ["on", "in"])
def test_what_rests_on_and_lies_in_what(relation: str) -> None:
    found = {
        (a, relation, b)
        for a in CORNER
        for b in CORNER
        if a != b and RELATIONS[relation](CORNER[a], CORNER[b])
    }
    assert found == {fact for fact in TRUE if fact[1] == relation}


@pytest.mark.parametrize("fact", sorted(fact for fact in TRUE if fact[1] in ("under", "above")))
def test_what_is_under_and_above_what(fact: tuple[str, str, str]) -> None:
    first, relation, second = fact
    assert RELATIONS[relation](CORNER[first], CORNER[second])
    assert not RELATIONS[relation](CORNER[second], CORNER[first])


def test_near_is_within_a_step_and_mutual() -> None:
    for a in CORNER:
        for b in CORNER:
            first, second = CORNER[a], CORNER[b]
            assert RELATIONS["near"](first, second) == RELATIONS["near"](second, first)
    assert RELATIONS["near"](CORNER["chair"], CORNER["table"])
    assert not RELATIONS["near"](CORNER["chair"], CORNER["sofa"])


def test_in_the_room_all_five_cups_stand_on_what_they_stand_on() -> None:
    objects = RoomSource(frames=1).objects
    boxes = [(thing.class_name, box(thing.lower_m, thing.upper_m)) for thing in objects]
    cups = [mine for name, mine in boxes if name == "cup"]
    tables = [other for name, other in boxes if name == "table"]
    cabinets = [other for name, other in boxes if name == "cabinet"]
    on = RELATIONS["on"]
    assert sum(any(on(cup, table) for table in tables) for cup in cups) == 3
    assert sum(any(on(cup, cabinet) for cabinet in cabinets) for cup in cups) == 2
    books = [mine for name, mine in boxes if name == "book"]
    (shelf,) = [other for name, other in boxes if name == "bookshelf"]
    assert sum(RELATIONS["in"](book, shelf) for book in books) == 38


def test_words_mean_relations_and_the_longer_come_first() -> None:
    assert set(WORDS.values()) == set(RELATIONS)
    words = list(WORDS)
    for place, word in enumerate(words):
        assert not any(other.startswith(f"{word} ") for other in words[place + 1 :])
