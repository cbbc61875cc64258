"""What every map is to those who look at it: the half of the socket that faces the commands.

Provisional until 1.0: a member may be added or change its name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.mapping.objects import SceneObject
from proground_log.perception.description import PerceptionDescription

UNSEEN, FREE, SURFACE = 0, 1, 2
"""What a map knows of a place; see `Map.seen`."""
BACKGROUND = 0.5
"""A point is background where a map gives that at least this probability."""


@dataclass(frozen=True)
class Meaning:
    """What a map says of N points, or of what N rays meet.

    Args:
        logits: float32 [N, K], for all prompts of its task.
        background: float32 [N] in [0, 1], how likely nothing was ever learnt there.
        embeddings: float32 [N, 512] in the space of the texts, of length 1; None where the map
            keeps none.
        levels: uint8 [N], the detector's pyramid level 0 to 2, 3 for none of them; None where the
            map does not tell them apart.
        uncertainty: float32 [N] in [0, 1]; None where the map has no head for it.
    """

    logits: np.ndarray
    background: np.ndarray
    embeddings: np.ndarray | None = None
    levels: np.ndarray | None = None
    uncertainty: np.ndarray | None = None

    @property
    def labels(self) -> np.ndarray:
        """The number of the best prompt, -1 for background, int16 [N]."""
        best = self.logits.argmax(axis=1)
        return np.where(self.background >= BACKGROUND, -1, best).astype(np.int16)


@dataclass(frozen=True)
class RenderedView:
    """What a camera would see of a map.

    Args:
        color: uint8 [H, W, 3] RGB.
        depth_m: float32 [H, W] along z in metres; both 0 where a ray meets no surface.
        meaning: of H * W rays; None where none was asked for, or the map has none.
    """

    color: np.ndarray
    depth_m: np.ndarray
    meaning: Meaning | None = None


class Map(Protocol):
    """A map: what rendering, meshing, queries and evaluation ask of it.

    Points are float [N, 3] in world metres, on the CPU; so is all that comes back.

    Attributes:
        kind: the name of its `MapperKind`.
        bounds: the box that was mapped.
        description: the task, its texts and the detector's heads; None where the map knows no
            meaning. Then nobody calls `ask` and `meaning`.
    """

    @property
    def kind(self) -> str: ...

    @property
    def bounds(self) -> Bounds: ...

    @property
    def description(self) -> PerceptionDescription | None: ...

    def render(
        self,
        camera: Camera,
        world_from_camera: np.ndarray,
        *,
        antialias: bool = False,
        with_meaning: bool = False,
    ) -> RenderedView:
        """The map as a camera would see it.

        Args:
            camera: without distortion; the size of the result.
            world_from_camera: pose, float64 [4, 4].
            antialias: colour edges as means, for a comparison with photographs.
            with_meaning: render what it means too; a map may leave that out, then it is asked at
                the points that the view shows.
        """
        ...

    def signed_distance(self, points_m: np.ndarray) -> np.ndarray:
        """Signed distances, float32 [N], positive in free space; only zero and sign have a scale
        that all maps share."""
        ...

    def color(self, points_m: np.ndarray) -> np.ndarray:
        """Colours, float32 [N, 3] RGB in [0, 1]."""
        ...

    def near_surface(self, axes_m: Sequence[np.ndarray]) -> np.ndarray:
        """Where a mesh may lie: which points of a lattice (its coordinates along x, y and z) are
        near a surface that was seen, bool [len(x), len(y), len(z)]."""
        ...

    def seen(self, points_m: np.ndarray) -> np.ndarray | None:
        """UNSEEN, FREE or SURFACE, uint8 [N]; None: the map does not know."""
        ...

    def ask(self, points_m: np.ndarray, texts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What texts (float32 [K, 512], of length 1) have to do with points.

        Returns:
            Logits, float32 [N, K], and how likely each point is background, float32 [N].
        """
        ...

    def meaning(self, points_m: np.ndarray) -> Meaning:
        """All that it can say of points, for its own task."""
        ...

    def objects(self) -> list[SceneObject] | None:
        """The objects that the map itself tells apart, without vertices; None: it does not."""
        ...

    def elements(self) -> np.ndarray | None:
        """Points that carry meaning, float32 [E, 3]; None where it is everywhere, as in a field."""
        ...

    def sizes_bytes(self) -> dict[str, int]:
        """Size of each part of the map on disk."""
        ...

    def header(self) -> Mapping[str, Any]:
        """What its file says beside the tensors: JSON values."""
        ...

    def tensors(self) -> dict[str, np.ndarray]:
        """What its file holds; the `load` of its kind makes a map of both again."""
        ...
