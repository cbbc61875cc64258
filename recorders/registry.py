"""The formats that can be recorded, as a table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import cast

from proground_log.errors import ProgroundError
from proground_log.locations import is_remote
from recorders.source import Source

NAMES_SHOWN, ENTRIES_TRIED = 8, 16


@dataclass(frozen=True)
class Format:
    """A format that can be recorded.

    Args:
        module, class_name: where its Source is; imported only when it is opened.
        description: one line for people, with what SOURCE has to be.
        takes_source: whether it reads a data set, the class's first argument, or makes one up.
    """

    module: str
    class_name: str
    description: str
    takes_source: bool = True

    def opener(self) -> Callable[..., Source]:
        """The class; beside the source, its arguments are the format's options."""
        return cast(Callable[..., Source], getattr(import_module(self.module), self.class_name))

    def recognise(self, source: Path) -> str | None:
        """Why a path looks like this format, in a few words, or None; opens nothing large.

        What is no file or folder of the kind, or may not be looked into, cannot be recognised: a
        format's own `recognise` need not catch what that raises.
        """
        recognise: Callable[[Path], str | None] = import_module(self.module).recognise
        try:
            return recognise(source)
        except Exception:  # Each remote file system has errors of its own.
            return None


FORMATS = {
    "seven-scenes": Format(
        "recorders.formats.seven_scenes",
        "SevenScenesSource",
        "7-Scenes or 3DMatch: a folder of frame-*.{color,depth,pose}.*",
    ),
    "tum": Format(
        "recorders.formats.tum",
        "TumSource",
        "TUM RGB-D or Bonn: a folder with rgb.txt, depth.txt, groundtruth.txt",
    ),
    "icl-nuim": Format(
        "recorders.formats.icl_nuim",
        "IclNuimSource",
        "ICL-NUIM: a folder with rgb/, depth/, associations.txt and a *.gt.* trajectory",
    ),
    "replica": Format(
        "recorders.formats.replica",
        "ReplicaSource",
        "Replica, NICE-SLAM's layout: a folder with results/ and traj.txt",
    ),
    "replica-semantic": Format(
        "recorders.formats.replica_semantic",
        "ReplicaSemanticSource",
        "Replica, Semantic-NeRF's and vMAP's layout: a folder with rgb/, depth/ and traj_w_c.txt",
    ),
    "scannet-sens": Format(
        "recorders.formats.scannet_sens",
        "ScannetSensSource",
        "ScanNet as it is published: a .sens file",
    ),
    "scannet": Format(
        "recorders.formats.scannet",
        "ScannetSource",
        "ScanNet, exported: a folder with color/, depth/, pose/ and intrinsic/",
    ),
    "scannetpp": Format(
        "recorders.formats.scannetpp",
        "ScannetppSource",
        "ScanNet++, the iPhone's stream: a folder with a video, depth.bin, pose_intrinsic_imu.json",
    ),
    "hm3dsem-walk": Format(
        "recorders.formats.hm3dsem_walk",
        "Hm3dsemWalkSource",
        "HM3DSem, HOV-SG's walks: a folder with rgb/, depth/, semantic/ and pose/",
    ),
    "record3d": Format(
        "recorders.formats.record3d",
        "Record3dSource",
        "Record3D: an .r3d file (needs proground-log[phone])",
    ),
    "arkitscenes": Format(
        "recorders.formats.arkitscenes",
        "ArkitscenesSource",
        "ARKitScenes: a video's folder with lowres_wide.traj",
    ),
    "nerfstudio": Format(
        "recorders.formats.nerfstudio",
        "NerfstudioSource",
        "nerfstudio: a folder with transforms.json, its frames with depth",
    ),
    "redwood": Format(
        "recorders.formats.redwood",
        "RedwoodSource",
        "Redwood or Open3D: a folder with image/ or color/, depth/ and trajectory.log",
    ),
    "colmap": Format(
        "recorders.formats.colmap.source",
        "ColmapSource",
        "COLMAP: a workspace with images/ and a model (cameras, images, points3D)",
    ),
    "ros2-bag": Format(
        "recorders.formats.ros.ros2_bag",
        "Ros2BagSource",
        "ROS 2 bag: an .mcap file, or a folder of them with metadata.yaml",
    ),
    "ros1-bag": Format(
        "recorders.formats.ros.ros1_bag",
        "Ros1BagSource",
        "ROS 1 bag: a .bag file (needs proground-log[ros1])",
    ),
    "synthetic": Format(
        "recorders.room", "RoomSource", "the built-in furnished room, no source", takes_source=False
    ),
}

AUTO = "auto"
"""In place of a format: find out which of them the source is."""


def open_source(name: str, source: Path | None = None, **options: object) -> Source:
    """Open a data set.

    Args:
        name: one of FORMATS, or "auto".
        source: what the format's description asks for; None for a format that takes none.
        options: keyword arguments of the format's class, such as `calibration`.

    Raises:
        ProgroundError: no such format or data set, or the data set is at fault.
        TypeError: the format has no such option.
    """
    name = of_source(name, source).format
    chosen = FORMATS[name]
    opener = chosen.opener()
    if chosen.takes_source != (source is not None):
        todo = chosen.description if chosen.takes_source else "leave the source out"
        what = "needs a source" if chosen.takes_source else f"has no use for {source}"
        raise ProgroundError(what, where=f"format {name}", todo=todo)
    # A store may know files alone, and no folders: what a URL lacks, the format says.
    if source is not None and not is_remote(source) and not source.exists():
        raise ProgroundError("no such folder or file", where=source, todo="check the path")
    return opener(source, **options) if chosen.takes_source else opener(**options)


@dataclass(frozen=True)
class Detection:
    """What a path was recognised as.

    Args:
        format: a name of FORMATS.
        reason: what it was recognised by, such as "has results/ and traj.txt".
    """

    format: str
    reason: str


def of_source(name: str, source: Path | None) -> Detection:
    """The format that a name means: "auto" the one that recognises the source, others their own.

    Raises:
        ProgroundError: there is no such format, or it is not clear what the source is.
    """
    if name == AUTO:
        if source is None:
            raise ProgroundError("needs a source", where=f"format {AUTO}", todo="name the data set")
        return detect(source)
    if name not in FORMATS:
        nearest = get_close_matches(name, FORMATS, n=1)
        hint = f"did you mean {nearest[0]}? " if nearest else ""
        raise ProgroundError(
            f"there is no format {name!r}",
            where=source or "record",
            todo=f"{hint}valid: {', '.join(sorted((*FORMATS, AUTO)))}",
        )
    return Detection(name, "was named")


def detect(source: Path) -> Detection:
    """The one format that recognises a path; opens no image.

    Raises:
        ProgroundError: nothing is there, no format recognises it, or several do.
    """
    seen = _seen(source)
    found = _all(source)
    if len(found) == 1:
        return found[0]
    if found:
        reasons = " and ".join(f"{each.format} ({each.reason})" for each in found)
        raise ProgroundError(
            f"looks like {reasons}",
            where=source,
            todo="say which: pglog record FORMAT SOURCE",
        )
    for folder in _folders(source):
        for each in _all(folder):
            raise ProgroundError(
                f"is no data set that pglog knows, but has one in it ({seen})",
                where=source,
                todo=f"give {folder}, which looks like {each.format} ({each.reason})",
            )
    needs = "".join(
        f"\n  {name}: {each.description}" for name, each in FORMATS.items() if each.takes_source
    )
    raise ProgroundError(
        f"is no data set that pglog knows ({seen})",
        where=source,
        todo=f"give one of these, or say which it is, pglog record FORMAT SOURCE:{needs}",
    )


def _all(source: Path) -> list[Detection]:
    """Every format that recognises a path, in the order of the table."""
    return [
        Detection(name, reason)
        for name, each in FORMATS.items()
        if each.takes_source and (reason := each.recognise(source))
    ]


def _folders(source: Path) -> list[Path]:
    """Some of the folders in a folder, in which people may have meant to look."""
    inside = sorted(source.iterdir(), key=lambda path: path.name) if source.is_dir() else []
    return [path for path in inside[:ENTRIES_TRIED] if path.is_dir()]


def _seen(source: Path) -> str:
    """What is there, in a few words; raises a ProgroundError where nothing is, or no access."""
    try:
        if source.is_file():
            return f"a file of {source.stat().st_size} bytes"
        if not source.is_dir():
            raise ProgroundError("no such folder or file", where=source, todo="check the path")
        names = sorted(path.name for path in source.iterdir())
    except OSError as error:
        raise ProgroundError(
            "may not be read", where=source, todo="check the permissions"
        ) from error
    if not names:
        return "an empty folder"
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return f"a folder with {', '.join(names[:NAMES_SHOWN])}{more}"
