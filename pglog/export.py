"""The command that hands a map on to other tools: export."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional

from pglog.common import SAME, Output, Run, err, warn
from proground_log.errors import ProgroundError
from proground_log.query.voxels import LOOK_VOXEL_M, OBJECTS_VOXEL_M

if TYPE_CHECKING:
    from proground_log.exports.labels import SurfaceLabels
    from proground_log.mapping.objects import SceneObject
    from proground_log.query.surface import Surfaces


What = Literal["mesh", "points", "openlex3d", "occupancy", "objects", "mcap"]


@dataclass(frozen=True)
class _Request:
    """What to write: of which run, where to, of what voxels."""

    surfaces: Surfaces
    output: Path
    voxel_m: float
    labels: bool
    robot_height: float


@dataclass(frozen=True)
class _Export:
    """One kind of export.

    Args:
        write: does it, and says what is in it.
        suffixes: what the output may be called; nothing for a folder.
        voxel_m: voxels of the surface, unless others are asked for.
        files: what will be written, by the output.
    """

    write: Callable[[_Request], str]
    suffixes: tuple[str, ...]
    voxel_m: float
    files: Callable[[Path], list[Path]] = lambda output: [output]


def export_command(
    run: Run,
    what: Annotated[What, Positional],
    *,
    output: Output,
    voxel_m: float | None = None,
    labels: bool = False,
    robot_height: float = 1.0,
    log: Path | None = None,
    overwrite: bool = False,
) -> int:
    """Write the map for other tools.

    Args:
        run: folder of a finished run.
        what: mesh (.ply, .glb), points (.ply), openlex3d (a folder), occupancy (.yaml and .pgm, as
            ROS map_server reads them), objects (.json), mcap (.mcap).
        output: the file or folder to write.
        voxel_m: voxels of the surface (mesh, points: 0.02; openlex3d: 0.05; else 0.03).
        labels: mesh: colours and names of what things are, in place of their own colours.
        robot_height: occupancy: what hangs higher than this is no obstacle, in metres.
        log: the run's log, where it has moved: it tells objects apart, and says what is up.
        overwrite: replace the output.
    """
    from proground_log.files import require_free
    from proground_log.query.surface import Surfaces
    from proground_log.run.opened import OpenedRun

    export = _EXPORTS[what]
    if export.suffixes and output.suffix.lower() not in export.suffixes:
        wanted = " or ".join(export.suffixes)
        raise ProgroundError(
            f"{what} is not written as {output.suffix or 'a file without a suffix'}",
            where=output,
            todo=f"call it {output.stem}{wanted}",
        )
    for file in export.files(output):
        require_free(file, overwrite=overwrite)
    surfaces = Surfaces(OpenedRun.finished(run, log))
    voxel_m = export.voxel_m if voxel_m is None else voxel_m
    with err.status(f"exporting {what}"):
        content = export.write(_Request(surfaces, output, voxel_m, labels, robot_height))
    print(f"{output}: {content}")
    return SAME


def _mesh(request: _Request) -> str:
    from proground_log.exports.glb import write_glb
    from proground_log.exports.ply import write_mesh_ply

    labels = _labelled(request)[1] if request.labels else None
    if request.output.suffix.lower() == ".glb":
        surface = request.surfaces.at(request.voxel_m)
        write_glb(request.output, surface.mesh, surface.up, labels)
        mesh = surface.mesh
    else:
        mesh = request.surfaces.at(request.voxel_m).mesh
        write_mesh_ply(request.output, mesh, labels)
    return f"{len(mesh.vertices_m)} vertices, {len(mesh.faces)} faces"


def _points(request: _Request) -> str:
    from proground_log.exports.ply import write_points_ply

    _, labels = _labelled(request)
    mesh = request.surfaces.at(request.voxel_m).mesh
    write_points_ply(request.output, mesh, labels)
    return f"{len(mesh.vertices_m)} points"


def _openlex3d(request: _Request) -> str:
    from proground_log.exports.openlex3d import write_openlex3d

    request.surfaces.run.require_meaning()
    mesh = request.surfaces.at(request.voxel_m).mesh
    return f"{write_openlex3d(request.output, request.surfaces.run.map, mesh)} points"


def _openlex3d_files(output: Path) -> list[Path]:
    from proground_log.exports.openlex3d import FILES

    return [output / name for name in FILES]


def _occupancy(request: _Request) -> str:
    from proground_log.exports.occupancy import write_occupancy
    from proground_log.navigation.floor_plan import Robot, draw_floor_plan

    robot = Robot(height_m=request.robot_height)
    surface = request.surfaces.at(request.voxel_m)
    plan = draw_floor_plan(surface.mesh.vertices_m, surface.mesh.faces, surface.up, robot)
    write_occupancy(request.output, plan)
    x, y = plan.cells.shape
    return f"{x} x {y} cells of {plan.cell_m} m"


def _occupancy_files(output: Path) -> list[Path]:
    from proground_log.exports.occupancy import image_of

    return [output, image_of(output)]


def _objects(request: _Request) -> str:
    from proground_log.exports.objects import object_rows, write_objects_json

    request.surfaces.run.require_meaning()
    surface = request.surfaces.at(request.voxel_m)
    objects = surface.objects
    if surface.caveat:
        warn(surface.caveat)
    rows, task = object_rows(objects), surface.description.task
    write_objects_json(request.output, rows, task, surface.up)
    return f"{len(objects)} objects"


def _mcap(request: _Request) -> str:
    from proground_log.exports.mcap_file import write_mcap
    from proground_log.run.ledger import read_ledger

    objects, labels = _labelled(request)
    mesh = request.surfaces.at(request.voxel_m).mesh
    entries = read_ledger(request.surfaces.run.folder.ledger)
    stamp_ns = max(entry["stamp_ns"] for entry in entries if entry["event"] == "frame")
    write_mcap(request.output, mesh, labels, objects, stamp_ns=stamp_ns)
    return f"{len(mesh.vertices_m)} points, {len(objects)} objects"


def _labelled(request: _Request) -> tuple[list[SceneObject], SurfaceLabels]:
    """The objects on the surface, and what that makes of its vertices."""
    from proground_log.exports.labels import label_surface

    request.surfaces.run.require_meaning()
    surface = request.surfaces.at(request.voxel_m)
    if surface.caveat:
        warn(surface.caveat)
    objects = surface.objects
    vertices = len(surface.mesh.vertices_m)
    return objects, label_surface(vertices, objects, surface.description.task)


_EXPORTS: dict[What, _Export] = {
    "mesh": _Export(_mesh, (".ply", ".glb"), LOOK_VOXEL_M),
    "points": _Export(_points, (".ply",), LOOK_VOXEL_M),
    "openlex3d": _Export(_openlex3d, (), 0.05, _openlex3d_files),
    "occupancy": _Export(_occupancy, (".yaml",), OBJECTS_VOXEL_M, _occupancy_files),
    "objects": _Export(_objects, (".json",), OBJECTS_VOXEL_M),
    "mcap": _Export(_mcap, (".mcap",), OBJECTS_VOXEL_M),
}
"""By name, in the order of the help."""
