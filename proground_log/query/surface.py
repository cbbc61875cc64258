"""The surfaces of a run's map, ready to be asked: each is made once."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import expit

from proground_log.errors import ProgroundError
from proground_log.frame import evenly
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.log.upright import levelled, nearest_axis, up_direction
from proground_log.mapping.objects import SceneObject
from proground_log.perception.description import PerceptionDescription
from proground_log.query.mesh import Mesh, extract_mesh
from proground_log.query.objects_of_labels import objects_of_labels
from proground_log.query.objects_of_regions import objects_of_regions
from proground_log.query.sightings import Sightings, find_sightings
from proground_log.run.opened import OpenedRun

MOST_FRAMES = 300
"""Frames, evenly spaced over those that were mapped, whose regions say what is one thing."""
MOST_REGIONS = 4000
"""Regions of these frames: fewer frames are looked at where they have more. Each is compared with
each, which takes 2 s and 0.7 GB."""
VIEWS_FOR_UP = 50
"""Frames, evenly spaced, whose poses say what is up."""
LEVEL_DEG = 5.0
"""An axis of the world this near to up is up: the world was meant to stand on it."""


class Surface:
    """The surface of a run's map; what is made of it is kept.

    Args:
        run: the run.
        mesh: its surface, V vertices, at least one.
        voxel_m: voxels of the mesh.
    """

    def __init__(self, run: OpenedRun, mesh: Mesh, voxel_m: float) -> None:
        self.run, self.mesh, self.voxel_m = run, mesh, voxel_m

    @property
    def description(self) -> PerceptionDescription:
        """The task, its texts and the detector's heads, of a map that has meaning."""
        description = self.run.map.description
        assert description is not None
        return description

    @cached_property
    def up(self) -> np.ndarray:
        """The world's upward direction, float64 [3]: as the log's camera has it; z, without it."""
        return _up(self.mesh, self.run.log_if_there)

    def ask(self, texts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logits [V, K] of the vertices for texts [K, 512], and how likely background, [V]."""
        return self.run.map.ask(self.mesh.vertices_m, texts)

    @cached_property
    def sightings(self) -> Sightings | None:
        """The regions that the run learnt from; None where no log has them.

        Frames that the run did not map do not count: what came too late for it, it cannot know.
        """
        log = self.run.log_if_there
        if log is None or log.task is None:
            return None
        mapped = self.run.mapped_frames
        chosen = [mapped[i] for i in evenly(len(mapped), MOST_FRAMES)]
        register = Registration(log.calibration)
        frames = (register(frame) for frame in log.frames(chosen))
        found = find_sightings(self.mesh.vertices_m, frames, self.voxel_m)
        return found.thinned(MOST_REGIONS)

    @cached_property
    def objects(self) -> list[SceneObject]:
        """Every object that a prompt of the task names.

        Those that the map tells apart by itself; else told apart by the regions of the log, or
        where there are none by what the map says of its vertices.
        """
        own = self.run.map.objects()
        if own is not None:
            return [self._laid(thing) for thing in own]
        description = self.description
        prompts = description.task.prompts
        if self.sightings is None:
            logits, background = self.ask(description.texts)
            return objects_of_labels(self.mesh, logits, background, prompts, self.up, self.voxel_m)
        relevance = expit(self.sightings.logits(description.heads, description.texts))
        return objects_of_regions(
            self.mesh, self.sightings, relevance, prompts, self.up, self.voxel_m
        )

    def _laid(self, thing: SceneObject) -> SceneObject:
        """An object of the map with the vertices in its box; they answer for it."""
        vertices = np.flatnonzero(thing.box.contains(self.mesh.vertices_m))
        return replace(thing, vertices=vertices, witnesses=vertices)

    @property
    def caveat(self) -> str | None:
        """Why objects are told apart worse than they might be; None where they are not."""
        if self.sightings is not None or self.run.map.objects() is not None:
            return None
        if self.run.log_if_there is None:
            why = "the run's log is not at hand (gone, out of reach or another one)"
            todo = "say with --log where it is"
        else:
            why = "the run's log has no regions"
            todo = "`pglog perceive` it, and replay what that gives"
        return f"{why}, so objects are told apart by the map alone, which is worse; {todo}"


class Surfaces:
    """The surfaces of a run's map by their voxels.

    Args:
        run: a finished run.
    """

    def __init__(self, run: OpenedRun) -> None:
        self.run = run
        self._meshes: dict[float, Mesh] = {}
        self._surfaces: dict[float, Surface] = {}

    def mesh(self, voxel_m: float) -> Mesh:
        """The surface as triangles; with no vertices where nothing was seen.

        Raises:
            ProgroundError: the voxels have no size.
        """
        if not voxel_m > 0:
            raise ProgroundError(
                f"the voxels are {voxel_m} m", where="surface", todo="choose more than 0"
            )
        if voxel_m not in self._meshes:
            self._meshes[voxel_m] = extract_mesh(self.run.map, voxel_m)
        return self._meshes[voxel_m]

    def at(self, voxel_m: float) -> Surface:
        """The surface, ready to be asked.

        Raises:
            ProgroundError: the voxels have no size, or there is no surface.
        """
        mesh = self.mesh(voxel_m)
        if not len(mesh.vertices_m):
            raise ProgroundError(
                "the map has no surface to ask",
                where=self.run.path,
                todo="map more frames, or frames with depth within the bounds",
            )
        return self._surfaces.setdefault(voxel_m, Surface(self.run, mesh, voxel_m))


def _up(mesh: Mesh, log: LogReader | None) -> np.ndarray:
    if log is None:
        return np.array([0.0, 0.0, 1.0])
    chosen = evenly(len(log), VIEWS_FOR_UP)
    poses = np.stack([frame.world_from_camera for frame in log.frames(chosen)])
    up = levelled(up_direction(poses), mesh.normals)
    axis, sign = nearest_axis(up)
    if sign * up[axis] >= np.cos(np.radians(LEVEL_DEG)):
        return sign * np.eye(3)[axis]
    return up
