"""Objects, classes and how bodies are gathered into a room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.room.furniture import Parts
from recorders.room.shapes import Primitive, Vector, pose

CLASSES = (
    *("wall", "floor", "ceiling", "chair", "table", "sofa", "bed", "bookshelf", "lamp", "plant"),
    *("cabinet", "television", "cushion", "cup", "book", "rug", "picture", "bin", "sink"),
    *("refrigerator", "window", "door"),
)
LABEL_NAMES: dict[int, str] = {0: "nothing"} | dict(enumerate(CLASSES, start=1))
LABELS = {name: label for label, name in LABEL_NAMES.items()}


@dataclass(frozen=True)
class RoomObject:
    """One thing in the room.

    Args:
        instance: its number, unique in the room, from 1.
        label: its class, a key of LABEL_NAMES.
        class_name: the name of its class.
        color_name: the colour one would call it by.
        center_m: middle of its box.
        lower_m, upper_m: the tightest box along the world's axes.
    """

    instance: int
    label: int
    class_name: str
    color_name: str
    center_m: Vector
    lower_m: Vector
    upper_m: Vector


@dataclass(frozen=True, eq=False)
class Scene:
    """The whole room: objects, their bodies, and which body belongs to which object.

    Args:
        objects: in order of their instance numbers.
        primitives: bodies in world axes.
        instances: instance number of each body, uint16 [P].
    """

    objects: tuple[RoomObject, ...]
    primitives: tuple[Primitive, ...]
    instances: np.ndarray

    @property
    def labels(self) -> np.ndarray:
        """Class of each body, uint16 [P]."""
        by_instance = np.array([o.label for o in self.objects], dtype=np.uint16)
        return np.asarray(by_instance[self.instances - 1])


class Furnisher:
    """Collects placed objects; jitter comes from one stream in a fixed order."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._objects: list[RoomObject] = []
        self._primitives: list[Primitive] = []
        self._instances: list[int] = []

    def jitter(self, reach: float) -> float:
        return float(self._rng.uniform(-reach, reach))

    def put(
        self, class_name: str, color: str, parts: Parts, at_m: Vector, turn_deg: float = 0.0
    ) -> None:
        """Place an object, turned about the vertical."""
        self._add(class_name, color, [part.moved(pose(at_m, (0, 0, turn_deg))) for part in parts])

    def rest(
        self, class_name: str, color: str, parts: Parts, at_m: Vector, turn_deg: Vector
    ) -> RoomObject:
        """Place an object turned about all axes so that its lowest point is at height at_m[2]."""
        x, y, z = at_m
        turned = [part.moved(pose((x, y, 0.0), turn_deg)) for part in parts]
        lowest_m = min(float(part.aabb()[0][2]) for part in turned)
        lifted = [part.moved(pose((0.0, 0.0, z - lowest_m))) for part in turned]
        return self._add(class_name, color, lifted)

    def _add(self, class_name: str, color: str, placed: list[Primitive]) -> RoomObject:
        corners = [part.aabb() for part in placed]
        lower = np.min([low for low, _ in corners], axis=0)
        upper = np.max([high for _, high in corners], axis=0)
        thing = RoomObject(
            instance=len(self._objects) + 1,
            label=LABELS[class_name],
            class_name=class_name,
            color_name=color,
            center_m=_vector((lower + upper) / 2),
            lower_m=_vector(lower),
            upper_m=_vector(upper),
        )
        self._objects.append(thing)
        self._primitives.extend(placed)
        self._instances.extend([thing.instance] * len(placed))
        return thing

    def scene(self) -> Scene:
        instances = np.array(self._instances, dtype=np.uint16)
        return Scene(tuple(self._objects), tuple(self._primitives), instances)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
