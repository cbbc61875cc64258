"""Small rooms with exact measures, as meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from proground_log.navigation.floor_plan import FloorPlan, Robot, draw_floor_plan

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner."""
Z_UP = np.array([0.0, 0.0, 1.0])
ROBOT = Robot()


@dataclass(frozen=True)
class Scene:
    """A mesh: vertices float64 [V, 3], faces int [F, 3]."""

    vertices_m: np.ndarray
    faces: np.ndarray

    def moved(self, rotation: np.ndarray) -> Scene:
        return Scene(self.vertices_m @ rotation.T, self.faces)


def scene(
    size_m: tuple[float, float], boxes: Sequence[Box] = (), *, floor: Sequence[Box] | None = None
) -> Scene:
    """A floor from (0, 0) on at height 0, and boxes; `floor` lays it in pieces instead."""
    pieces = [((0.0, 0.0, 0.0), (*size_m, 0.0))] if floor is None else floor
    meshes = [_sheet(piece) for piece in pieces]
    for lower_m, upper_m in boxes:
        meshes.append(trimesh.creation.box(bounds=np.array([lower_m, upper_m])))
    whole = trimesh.util.concatenate(meshes)
    return Scene(np.asarray(whole.vertices), np.asarray(whole.faces))


def plan_of(room: Scene, robot: Robot = ROBOT, cell_m: float = 0.05) -> FloorPlan:
    return draw_floor_plan(room.vertices_m, room.faces, Z_UP, robot, cell_m)


def distance_m(
    places_m: np.ndarray, size_m: tuple[float, float], boxes: Sequence[Box]
) -> np.ndarray:
    """The true distance of places [N, 2] on the floor from its rim and from boxes."""
    rim = np.concatenate([places_m, np.array(size_m) - places_m], axis=1).min(axis=1)
    away = [rim]
    for lower_m, upper_m in boxes:
        outside = places_m - places_m.clip(lower_m[:2], upper_m[:2])
        away.append(np.linalg.norm(outside, axis=1))
    return np.asarray(np.min(away, axis=0))


def _sheet(piece: Box) -> trimesh.Trimesh:
    (left, low, height), (right, high, _) = piece
    corners = [(left, low, height), (right, low, height), (right, high, height)]
    return trimesh.Trimesh([*corners, (left, high, height)], [(0, 1, 2), (0, 2, 3)], process=False)
