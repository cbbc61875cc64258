"""The objects of a map that has no log at hand: every vertex is of the prompt that wins there, and
neighbours of one prompt are one thing (paper, Sec. 5.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import expit, logit

from proground_log.mapping.boxes import shared_volume_m3
from proground_log.mapping.objects import SceneObject
from proground_log.query.instances import GAP_VOXELS, find_instances
from proground_log.query.mesh import Mesh
from proground_log.query.objects import LEAST_RELEVANCE, object_of
from proground_log.query.settling import settle_labels

LEAST_SPOT_M2 = 0.01
"""Of an object: some of what one sees of a cup. Smaller spots are specks of noise: with what is
enough for a region, 0.007, mean F1 at IoU 0.25 in four built-in rooms falls from 58.3 % to 57.9."""
BACKGROUND_WEIGHT = 3.0
"""A logit of the heads that tell background from things counts so many of a prompt's: theirs go
from -4 to 4 where those of prompts go from -10 to 10."""
DUPLICATE_SHARE = 0.6
"""Of the smaller of two boxes of one label, so much inside the other makes them one object."""


def objects_of_labels(
    mesh: Mesh,
    logits: np.ndarray,
    background: np.ndarray,
    prompts: Sequence[str],
    up: np.ndarray,
    voxel_m: float,
) -> list[SceneObject]:
    """Find every object that a prompt names.

    Args:
        mesh: the map's surface, V vertices.
        logits: float [V, K] of `vertex_logits`, for the prompts and then for further texts that
            compete with them and that no object is of (a task's irrelevant prompts).
        background: float [V] of `background_probability`.
        prompts: the labels, without walls, floors and ceilings.
        up: the world's upward direction [3], of length 1.
        voxel_m: voxels of the mesh.

    Returns:
        The objects by their prompts' order, then by falling score, then as `find_instances` has
        them.
    """
    chance = logit(background.astype(np.float64).clip(1e-6, 1 - 1e-6))
    nothing = logits.max(axis=1) + BACKGROUND_WEIGHT * chance
    evidence = np.concatenate([logits, nothing[:, None]], axis=1)
    labels = settle_labels(evidence, mesh.faces, voxel_m)
    found = []
    for number, prompt in enumerate(prompts):
        relevance = np.where(labels == number, expit(logits[:, number].astype(np.float64)), 0)
        instances = find_instances(
            mesh.vertices_m,
            mesh.faces,
            relevance,
            threshold=np.finfo(np.float64).tiny,
            most_gap_m=GAP_VOXELS * voxel_m,
            # A surface has a vertex or more for each of the voxels' faces that it crosses.
            least_vertices=int(np.ceil(LEAST_SPOT_M2 / voxel_m**2)),
        )
        sure = [
            object_of(prompt, thing, mesh.vertices_m, up, witnesses=thing.vertices)
            for thing in instances
            if relevance[thing.vertices].mean() >= LEAST_RELEVANCE
        ]
        found += without_duplicates(sure)
    return found


def without_duplicates(objects: Sequence[SceneObject]) -> list[SceneObject]:
    """Objects of one label, less those that lie in the box of a larger one.

    Args:
        objects: of one label, best first.

    Returns:
        Those that stay, in the order given.
    """
    kept: list[SceneObject] = []
    for thing in sorted(objects, key=lambda one: -len(one.vertices)):
        share = [shared_volume_m3(thing.box, other.box) / thing.box.volume_m3 for other in kept]
        if max(share, default=0.0) < DUPLICATE_SHARE:
            kept.append(thing)
    return [thing for thing in objects if thing in kept]
