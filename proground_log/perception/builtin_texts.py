"""A small text space made of a table of household words: it needs no download.

It is built like CLIP's, so that what works here works there: all texts share a common part (two
unrelated ones have a cosine near 0.7), similar things lie closer together, synonyms closest.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.perception.texts import NameIndex
from proground_log.regions import EMBEDDING_WIDTH
from proground_log.streams import stream

COMMON_SHARE = 0.7
"""Cosine of unrelated texts; that of CLIP ViT-B/32 is 0.74 in the mean."""
_FAMILY_SHARE = 0.45
"""Of what is not common, how much a family shares."""
_SYNONYM_COSINE = 0.95
_ADJECTIVE_WEIGHT = 0.4

# Each line is a concept and its synonyms, under the family whose members resemble each other.
_TABLE: dict[str, tuple[str, ...]] = {
    "shell": (
        "wall, partition",
        "floor, flooring, ground",
        "ceiling, roof",
    ),
    "openings": (
        "door, doorway",
        "door handle, doorknob, door knob",
        "window, window pane",
        "curtain, drape, window blind",
    ),
    "seats": (
        "chair, dining chair, kitchen chair",
        "armchair, easy chair",
        "stool, bar stool",
        "bench, seat",
        "sofa, couch, settee",
    ),
    "tables": (
        "table, tabletop",
        "coffee table, cocktail table",
        "dining table, dinner table",
        "desk, writing desk, office desk",
        "nightstand, bedside table, night table",
        "counter, countertop, worktop",
    ),
    "storage": (
        "cabinet, cupboard",
        "kitchen cabinet, kitchen cupboard",
        "tv cabinet, tv stand, media console",
        "wardrobe, closet, armoire",
        "bookshelf, bookcase, shelf",
        "shoe rack, shoe shelf",
        "drawers, chest of drawers, dresser",
    ),
    "bedding": (
        "bed, bedstead, mattress",
        "cushion, pillow",
        "blanket, duvet",
        "towel, hand towel",
    ),
    "lights": (
        "lamp, luminaire, table lamp",
        "chandelier, ceiling lamp, pendant lamp",
        "candle, candlestick",
    ),
    "wall pieces": (
        "picture, painting, picture frame",
        "mirror, looking glass",
        "clock, wall clock",
        "board, whiteboard, notice board",
    ),
    "screens": (
        "television, tv, monitor, tv screen",
        "tablet, tablet computer",
        "laptop, notebook computer",
        "telephone, phone",
        "security camera, surveillance camera, cctv camera",
    ),
    "vessels": (
        "cup, teacup, coffee cup",
        "mug, beaker",
        "bowl, basin",
        "bottle, flask",
        "plate, saucer",
        "vase, flower vase",
        "tableware, dishes, crockery",
        "kitchen utensils, kitchenware, cutlery",
        "seasoning box, spice box, spice rack",
    ),
    "containers": (
        "bin, trash can, waste basket, rubbish bin",
        "box, carton",
        "basket, hamper",
        "bag, suitcase",
    ),
    "appliances": (
        "refrigerator, fridge, freezer",
        "stove, cooker, hob",
        "oven, microwave",
        "range hood, extractor hood, cooker hood",
        "air conditioner, air conditioning, ac unit",
        "washing machine, washer",
        "radiator, heater",
    ),
    "plumbing": (
        "sink, washbasin, wash basin",
        "bathtub, tub",
        "toilet, lavatory",
        "shower, shower cabin",
    ),
    "paper": (
        "book, novel",
        "magazine, newspaper",
    ),
    "floor textiles": (
        "rug, carpet",
        "doormat, mat",
    ),
    "greenery": (
        "plant, houseplant, potted plant",
        "flower, bouquet",
    ),
    "sports": (
        "ball, football, sports ball",
        "dumbbell, hand weight",
        "fitness equipment, exercise equipment, gym equipment",
        "bicycle, bike",
    ),
    "animals": (
        "dog, puppy",
        "cat, kitten",
        "person, human",
    ),
    "instruments": (
        "piano, grand piano",
        "guitar, ukulele",
    ),
    "outdoors": (
        "car, automobile",
        "tree, bush",
    ),
}
_CONCEPTS: dict[str, tuple[str, str]] = {
    name: (names.split(", ")[0], family)
    for family, lines in _TABLE.items()
    for names in lines
    for name in names.split(", ")
}
"""By every name: its concept and the concept's family."""
_NAMES = tuple(_CONCEPTS)
_WHERE = "the built-in texts (others: perceive with --detector and --text-encoder or --vocabulary)"
_INDEX = NameIndex(_NAMES, _WHERE)
_ARTICLES = frozenset(("a", "an", "the"))
_ADJECTIVES = frozenset(
    (
        *("black", "white", "gray", "grey", "brown", "beige", "red", "orange", "yellow", "green"),
        *("blue", "purple", "pink", "wooden", "metal", "glass", "leather", "small", "large"),
        *("big", "round", "tall", "old", "new"),
    )
)


class BuiltinTexts:
    """Embeddings of household words, and of such words behind adjectives ("a red chair").

    >>> sofa, couch, lamp = BuiltinTexts().embed(["sofa", "couch", "lamp"])
    >>> bool(sofa @ couch > sofa @ lamp)
    True
    """

    @property
    def origin(self) -> dict[str, str]:
        """What it is, for logs and maps."""
        return {"kind": "built-in", "version": "1"}

    def embed(self, names: Sequence[str]) -> np.ndarray:
        """Embeddings float32 [N, 512], of length 1.

        Raises:
            ProgroundError: a name is unknown; it names those that come nearest.
        """
        rows = [_embedding(*_parse(name)) for name in names]
        return np.array(rows, np.float32).reshape(-1, EMBEDDING_WIDTH)

    def knows(self, name: str) -> bool:
        """Whether `embed` takes it."""
        try:
            _parse(name)
        except ProgroundError:
            return False
        return True

    @property
    def concepts(self) -> tuple[str, ...]:
        """One name for each thing that it knows."""
        return tuple(dict.fromkeys(concept for concept, _ in _CONCEPTS.values()))

    def concept(self, name: str) -> str:
        """What a name means, whatever synonym or adjective says it; raises as `embed` does."""
        return _CONCEPTS[_parse(name)[0]][0]


@cache
def common_direction() -> np.ndarray:
    """What all texts share, float64 [512] of length 1: each lies at sqrt(COMMON_SHARE) to it."""
    return _unit(stream(0, "text").standard_normal(EMBEDDING_WIDTH))


def _parse(text: str) -> tuple[str, tuple[str, ...]]:
    """The known name at the end of a text, and the adjectives before it."""
    words, adjectives = text.lower().split(), []
    while len(words) > 1 and words[0] in _ADJECTIVES | _ARTICLES:
        adjectives.append(words.pop(0))
    name = _NAMES[_INDEX.row(" ".join(words))]
    return name, tuple(word for word in adjectives if word in _ADJECTIVES)


@cache
def _embedding(name: str, adjectives: tuple[str, ...]) -> np.ndarray:
    concept, family = _CONCEPTS[name]
    own = _mix(_direction(f"family/{family}"), _direction(f"concept/{concept}"), _FAMILY_SHARE)
    if name != concept:
        kept = (_SYNONYM_COSINE - COMMON_SHARE) / (1 - COMMON_SHARE)
        own = _mix(own, _direction(f"name/{name}"), kept**2)
    for adjective in adjectives:
        own = _unit(own + _ADJECTIVE_WEIGHT * _direction(f"adjective/{adjective}"))
    return _mix(common_direction(), own, COMMON_SHARE).astype(np.float32)


@cache
def _direction(name: str) -> np.ndarray:
    """A direction of its own for each name, at a right angle to the common one."""
    free = stream(0, f"text/{name}").standard_normal(EMBEDDING_WIDTH)
    return _unit(free - (free @ common_direction()) * common_direction())


def _mix(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """A vector of length 1 of which the first, in squares, makes the share given."""
    aside = _unit(second - (second @ first) * first)
    return np.sqrt(share) * first + np.sqrt(1 - share) * aside


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
