"""Level sheets of vertices, and what frames saw on them, given mask by mask."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from proground_log.query.mesh import Mesh
from proground_log.query.sightings import Sightings
from proground_log.regions import EMBEDDING_WIDTH

UP = np.array([0.0, 0.0, 1.0])

Look = tuple[np.ndarray, Sequence[np.ndarray]]
"""What a frame saw, bool [V], and of this its regions, likewise: no vertex is of two."""


def sheet(rows: int, columns: int, voxel_m: float) -> Mesh:
    """A level sheet of vertices, a voxel apart, that faces up."""
    grid = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=-1)
    plan = grid.reshape(-1, 2) * voxel_m
    vertices_m = np.concatenate([plan, np.zeros((len(plan), 1))], axis=1).astype(np.float32)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    normals = np.tile(UP.astype(np.float32), (len(plan), 1))
    return Mesh(vertices_m, faces, normals, np.zeros((len(plan), 3), np.uint8))


def patch(rows: slice, columns: slice, shape: tuple[int, int]) -> np.ndarray:
    """Some of a sheet's vertices, bool [V]."""
    chosen = np.zeros(shape, bool)
    chosen[rows, columns] = True
    return chosen.ravel()


def sightings_of(looks: Sequence[Look], vertices: int) -> Sightings:
    """What frames saw; nobody asks for embeddings."""
    masks = [mask for _, regions in looks for mask in regions]
    frame_of = [number for number, (_, regions) in enumerate(looks) for _ in regions]
    regions = np.array(masks, np.float32).reshape(-1, vertices)
    seen = np.array([saw for saw, _ in looks], np.float32).reshape(-1, vertices)
    return Sightings(
        regions=csr_array(regions.T),
        seen=csr_array(seen.T),
        frame_of=np.array(frame_of, np.int64),
        embeddings=np.zeros((len(masks), EMBEDDING_WIDTH), np.float32),
        levels=np.zeros(len(masks), np.uint8),
    )
