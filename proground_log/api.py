"""Logs and runs from Python: what the commands do, as objects and arrays.

    import proground_log as pg

    log = pg.open_log("room.mcap")
    run = pg.open_run("run")

What comes back are the library's own records, described where they are defined. Nothing is written;
errors that a user can mend are `proground_log.errors.ProgroundError`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from proground_log.locations import located
from proground_log.query.voxels import LOOK_VOXEL_M, OBJECTS_VOXEL_M

if TYPE_CHECKING:
    from proground_log.camera import Camera
    from proground_log.log.reader import LogReader
    from proground_log.mapping.map import Map, RenderedView
    from proground_log.mapping.objects import SceneObject
    from proground_log.navigation.floor_plan import Robot
    from proground_log.navigation.journey import Journey
    from proground_log.query.ask import Answer
    from proground_log.query.mesh import Mesh
    from proground_log.query.surface import Surface
    from proground_log.run.manifest import Manifest


def open_log(path: str | Path) -> LogReader:
    """Open a log (.mcap), here or behind a URL.

    Of the reader one wants `len(log)`, `log.frames()`, `log.calibration`, `log.label_names`,
    `log.recording` (source, format, bounds) and `log.task`.

    Raises:
        ProgroundError: it is no log, or is damaged.
    """
    from proground_log.log.reader import LogReader

    return LogReader(located(str(path)))


def open_run(path: str | Path, *, log: str | Path | None = None) -> Run:
    """Open the folder of a finished run.

    Args:
        path: the folder.
        log: the run's log, where it has moved.

    Raises:
        ProgroundError: there is no finished run.
    """
    return Run(Path(path), None if log is None else located(str(log)))


class Run:
    """A finished run; made by `open_run`. What is read of it, is read once, when it is needed.

    Args:
        path: its folder.
        log_path: its log, or None where it is where the run found it.
    """

    def __init__(self, path: Path, log_path: Path | None = None) -> None:
        from proground_log.query.surface import Surfaces
        from proground_log.run.opened import OpenedRun

        self.path = path
        self._opened = OpenedRun.finished(path, log_path)
        self._surfaces = Surfaces(self._opened)

    @property
    def manifest(self) -> Manifest:
        """What made the run (`manifest.config`) and its summary (`manifest.result`)."""
        return self._opened.manifest

    @property
    def log(self) -> LogReader:
        """The log that the run was made of; raises a ProgroundError where it is another."""
        return self._opened.log

    @property
    def map(self) -> Map:
        """The map."""
        return self._opened.map

    @property
    def prompts(self) -> tuple[str, ...]:
        """What the run's task looked for; nothing where its log had no regions."""
        description = self.map.description
        return () if description is None else description.task.all_prompts

    def events(self, kind: str | None = None) -> Iterator[dict[str, Any]]:
        """The entries of the ledger in their order.

        Args:
            kind: only these: "frame", "dropped", "scheduled", "keyframe", "step", "done", ...

        Raises:
            ProgroundError: the ledger was changed.
        """
        from proground_log.run.ledger import read_ledger

        for entry in read_ledger(self._opened.folder.ledger):
            if kind is None or entry["event"] == kind:
                yield entry

    @property
    def losses(self) -> dict[str, np.ndarray]:
        """The loss of each step, by term: float32 [S], nan where a step had no such term.

        Terms are unweighted, but "total" is the weighted sum. "step" and "frame" are int64 [S],
        the step's number and that of the newest frame; "sim_time_ns" is simulated time.
        """
        history = self._opened.history
        return {
            "step": history.step,
            "frame": history.step_frame,
            "sim_time_ns": history.step_ns,
            **history.losses,
        }

    def render(self, world_from_camera: np.ndarray, camera: Camera | None = None) -> RenderedView:
        """The map as a camera would see it.

        Args:
            world_from_camera: pose, [4, 4]; camera axes x right, y down, z forward.
            camera: without distortion; None for the depth camera of the run's log.

        Returns:
            `color` uint8 [H, W, 3] RGB and `depth_m` float32 [H, W], 0 where there is nothing.

        Raises:
            ProgroundError: the pose is not rigid, or the log is needed and not there.
        """
        from proground_log.camera import require_rigid

        pose = require_rigid(world_from_camera, where="world_from_camera")
        return self.map.render(camera or self.log.calibration.depth.pinhole(), pose)

    def mesh(self, voxel_m: float = LOOK_VOXEL_M) -> Mesh:
        """The surface as triangles: `vertices_m`, `faces`, `normals` and `colors`.

        Args:
            voxel_m: distance between the points at which the field is asked.

        Raises:
            ProgroundError: the map has no surface.
        """
        return self._surfaces.at(voxel_m).mesh

    def surface(self, voxel_m: float = OBJECTS_VOXEL_M) -> Surface:
        """The surface with what is up; of a map with meaning it can be asked (`ask`, `objects`).

        Arguments and errors as for `mesh`; asking it is an error if the log is another.
        """
        return self._surfaces.at(voxel_m)

    def objects(self, voxel_m: float = OBJECTS_VOXEL_M) -> list[SceneObject]:
        """What stands there: of each object its label, position, extent, score, box, `vertices` of
        `mesh(voxel_m)`, and `views`: frames in which the detector found it (None where no log has
        what it found).

        Raises:
            ProgroundError: the map knows no meaning or has no surface, or the log is another.
        """
        self._opened.require_meaning()
        return self.surface(voxel_m).objects

    def query(
        self,
        text: str,
        *,
        voxel_m: float = OBJECTS_VOXEL_M,
        top_k: int = 5,
        vocabulary: Path | None = None,
        text_encoder: Path | None = None,
    ) -> Answer:
        """Where something is: `things` (objects, best first), and `scores` of all vertices.

        Args:
            text: what to look for, such as "red chair", "chair, not sofa" or "cup on table".
            voxel_m: voxels of the surface that is asked.
            top_k: most things to find.
            vocabulary: embeddings of texts that are none of the task's prompts (.npz).
            text_encoder: computes the embeddings of such texts (.onnx).

        Raises:
            ProgroundError: the map knows no meaning, or nobody knows the text.
        """
        from proground_log.perception.map_texts import Texts
        from proground_log.query.ask import query

        texts = Texts(vocabulary, text_encoder)
        _, (answer,) = query(self._surfaces, [text], voxel_m, top_k, texts=texts)
        return answer

    def navigate(
        self,
        start: tuple[float, float],
        goal: str | tuple[float, float],
        *,
        robot: Robot | None = None,
        voxel_m: float = OBJECTS_VOXEL_M,
    ) -> Journey:
        """A way across the floor that a robot can drive: `route`, the floor's `plan`, and more.

        Args:
            start: x and y of the floor plan, metres.
            goal: such a place, or what to look for.
            robot: what drives; None for `Robot()`.
            voxel_m: voxels of the mesh that the floor plan is drawn of.

        Raises:
            ProgroundError: there is no such way, floor or thing; it says why.
        """
        from proground_log.navigation.floor_plan import Robot
        from proground_log.navigation.journey import navigate_surface

        if isinstance(goal, str):
            self._opened.require_meaning()
        return navigate_surface(self.surface(voxel_m), start, goal, robot or Robot())
