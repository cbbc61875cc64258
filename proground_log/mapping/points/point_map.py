"""A map of points with colours, normals and, where there were regions, meaning."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.mapping.map import SURFACE, UNSEEN, Meaning, RenderedView
from proground_log.mapping.objects import SceneObject
from proground_log.mapping.points.drawing import draw_points
from proground_log.perception.description import PerceptionDescription

REACH = 2.0
"""A point speaks for what is no farther away than so many spacings, as far as surface goes."""
BACKGROUND_M = 0.1
"""What is farther than this from all that carries meaning is background."""


@dataclass(frozen=True, eq=False)
class PointMap:
    """P points a spacing apart; the first to fit the socket that keeps no field.

    Args:
        kind: the name of the kind of mapper that made it.
        bounds: the box that was mapped.
        description: what the meaning is of; None where there is none.
        spacing_m: distance between neighbours.
        points_m: float32 [P, 3], world axes.
        colors: uint8 [P, 3] RGB.
        normals: float32 [P, 3], towards free space.
        meaning_m: float32 [E, 3], the points that carry meaning.
        features: float32 [E, 513] of `TextHeads.in_text_space`, a row each.
    """

    kind: str
    bounds: Bounds
    description: PerceptionDescription | None
    spacing_m: float
    points_m: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    meaning_m: np.ndarray
    features: np.ndarray

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points_m)

    @cached_property
    def _meaning_tree(self) -> cKDTree:
        return cKDTree(self.meaning_m)

    def render(
        self,
        camera: Camera,
        world_from_camera: np.ndarray,
        *,
        antialias: bool = False,  # noqa: ARG002 - a square has no edge to smooth
        with_meaning: bool = False,  # noqa: ARG002 - asked at what the view shows
    ) -> RenderedView:
        """The points as squares; see `Map.render`."""
        radius_m = self.spacing_m / 2
        owner, depth_m = draw_points(self.points_m, camera, world_from_camera, radius_m)
        colors = np.concatenate([self.colors, np.zeros((1, 3), np.uint8)])
        return RenderedView(colors[owner], depth_m)

    def signed_distance(self, points_m: np.ndarray) -> np.ndarray:
        """Distances along the normal of the nearest point, float32 [N], in metres."""
        if not len(self.points_m):
            return np.ones(len(points_m), np.float32)
        nearest = self._tree.query(points_m)[1]
        along_m = (points_m - self.points_m[nearest]) * self.normals[nearest]
        return along_m.sum(axis=1).astype(np.float32)

    def color(self, points_m: np.ndarray) -> np.ndarray:
        """Colours of the nearest points, float32 [N, 3] in [0, 1]."""
        if not len(self.points_m):
            return np.zeros((len(points_m), 3), np.float32)
        return self.colors[self._tree.query(points_m)[1]].astype(np.float32) / 255

    def near_surface(self, axes_m: Sequence[np.ndarray]) -> np.ndarray:
        """Which points of a lattice a point speaks for; see `Map.near_surface`."""
        near = np.zeros([len(axis_m) for axis_m in axes_m], bool)
        if len(self.points_m):
            step_m = max(float(np.diff(axis_m).max(initial=0)) for axis_m in axes_m)
            reach_m = REACH * self.spacing_m + step_m
            for x, x_m in enumerate(axes_m[0]):
                grid = np.meshgrid([x_m], axes_m[1], axes_m[2], indexing="ij")
                places_m = np.stack(grid, axis=-1).reshape(-1, 3)
                distance_m = self._tree.query(places_m, distance_upper_bound=reach_m)[0]
                near[x] = np.isfinite(distance_m).reshape(near.shape[1:])
        return near

    def seen(self, points_m: np.ndarray) -> np.ndarray | None:
        """SURFACE within reach of a point; what else was free, nobody wrote down."""
        if not len(self.points_m):
            return np.full(len(points_m), UNSEEN, np.uint8)
        distance_m = self._tree.query(points_m)[0]
        return np.where(distance_m <= self.spacing_m, SURFACE, UNSEEN).astype(np.uint8)

    def ask(self, points_m: np.ndarray, texts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the nearest points with meaning say; see `Map.ask`."""
        if not len(self.meaning_m):
            nothing = np.zeros((len(points_m), len(texts)), np.float32)
            return nothing, np.ones(len(points_m), np.float32)
        distance_m, nearest = self._meaning_tree.query(points_m)
        said = self.features[:, :-1] @ texts.T + self.features[:, -1:]
        return said[nearest].astype(np.float32), np.asarray(distance_m > BACKGROUND_M, np.float32)

    def meaning(self, points_m: np.ndarray) -> Meaning:
        """What the nearest points with meaning say of the task."""
        assert self.description is not None
        logits, background = self.ask(points_m, self.description.texts)
        if not len(self.meaning_m):
            return Meaning(logits, background)
        features = self.features[self._meaning_tree.query(points_m)[1], :-1]
        length = np.linalg.norm(features, axis=1, keepdims=True)
        return Meaning(logits, background, features / np.maximum(length, 1e-8))

    def objects(self) -> list[SceneObject] | None:
        """None: points do not tell objects apart."""
        return None

    def elements(self) -> np.ndarray | None:
        """The points that carry meaning."""
        return self.meaning_m

    def sizes_bytes(self) -> dict[str, int]:
        """Size of each part of the map on disk."""
        return {name: array.nbytes for name, array in self.tensors().items()}

    def header(self) -> dict[str, Any]:
        """Bounds and spacing."""
        return {"bounds": dataclasses.asdict(self.bounds), "spacing_m": self.spacing_m}

    def tensors(self) -> dict[str, np.ndarray]:
        """The points, and the description."""
        names = ("points_m", "colors", "normals", "meaning_m", "features")
        tensors = {name: np.ascontiguousarray(getattr(self, name)) for name in names}
        if self.description is not None:
            tensors["perception"] = np.frombuffer(self.description.to_bytes(), np.uint8)
        return tensors


def load_point_map(
    header: Mapping[str, Any],
    tensors: dict[str, np.ndarray],
    *,
    where: Path,
    device: str,  # noqa: ARG001 - points are asked on the CPU
) -> PointMap:
    """A map of what `PointMap.header` and `PointMap.tensors` gave: the `load` of its kind."""
    bounds = Bounds(*(tuple(header["bounds"][corner]) for corner in ("lower_m", "upper_m")))
    described = tensors.pop("perception", None)
    description = None
    if described is not None:
        description = PerceptionDescription.from_bytes(described.tobytes(), where=where)
    return PointMap(header["kind"], bounds, description, header["spacing_m"], **tensors)
