"""The ground truth beside renderings of Replica: info_semantic.json and a labelled mesh.

`classes` is a list of {id, name}; `id_to_label` gives, at the place of an instance's number, its
class, below 0 where it has none.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.files import require_file
from recorders.reading.frame_files import Numbered
from recorders.reading.json_file import read_json

INFO_NAME = "info_semantic.json"
LARGEST_CLASS = 2**16 - 1
PLY_HEADER_BYTES = 2**16
"""More than any header of a PLY has."""


def truth_images(source: Path) -> dict[str, Numbered]:
    """The images of classes and of things, which some renderings have, by what a frame has."""
    return {
        name: Numbered(source / kind, rf"{kind}_(\d+)\.png", f"{kind}_{{number}}.png")
        for name, kind in (("labels", "semantic_class"), ("instances", "semantic_instance"))
    }


def read_label_names(path: Path) -> dict[int, str]:
    """Class names by class number; 0 and below mean "nothing" and have none."""
    try:
        names = {_whole(c["id"]): str(c["name"]) for c in read_json(path)["classes"]}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProgroundError(
            f"does not name the classes ({error!r})",
            where=path,
            todo='it needs {"classes": [{"id": number, "name": text}, ...]}',
        ) from error
    return {label: name for label, name in sorted(names.items()) if label > 0}


def read_instance_classes(path: Path) -> np.ndarray:
    """The class of each instance by its number, uint16 [N], 0 = none."""
    try:
        classes = np.array([max(0, _whole(label)) for label in read_json(path)["id_to_label"]])
        if classes.size and classes.max() > LARGEST_CLASS:
            raise ValueError(f"a class of {classes.max()}")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProgroundError(
            f"does not tell the classes of the instances ({error!r})",
            where=path,
            todo='it needs {"id_to_label": [class of instance 0, class of instance 1, ...]}',
        ) from error
    return classes.astype(np.uint16)


def _whole(value: Any) -> int:
    """A number of JSON as int; by way of a float, for 1e999999999 has too many digits."""
    return int(float(value))


def find_mesh(folder: Path) -> tuple[Path | None, dict[str, str]]:
    """The one *mesh_semantic*.ply of a folder if its vertices have labels, and a note if not.

    Replica's own meshes have the number of an object at each face and no labels.
    """
    meshes = sorted(path for path in folder.glob("*mesh_semantic*.ply") if path.is_file())
    if not meshes:
        return None, {}
    if len(meshes) > 1:
        return None, {"mesh": f"left out: there are {len(meshes)} named *mesh_semantic*.ply"}
    if not _has_labels(meshes[0]):
        return None, {"mesh": f"left out: the vertices of {meshes[0].name} have no labels"}
    return meshes[0], {}


def _has_labels(mesh: Path) -> bool:
    with require_file(mesh).open("rb") as stream:
        header = stream.read(PLY_HEADER_BYTES).partition(b"end_header")[0]
    vertex = header.partition(b"element vertex")[2].partition(b"\nelement")[0]
    return re.search(rb"^property \w+ label\s*$", vertex, re.MULTILINE) is not None
