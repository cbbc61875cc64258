"""The folder that the OpenLex3D benchmark reads predictions from.

As its toolbox describes it (github.com/openlex3d/openlex3d, "Predictions"): `embeddings.npy`,
`index.npy` and `point_cloud.pcd`, where `embeddings[index[i]]` belongs to point i of the cloud.
Points and texts are compared there by the cosine of their embeddings.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.files import written_whole
from proground_log.mapping.map import BACKGROUND, Map
from proground_log.query.mesh import Mesh

FILES = ("embeddings.npy", "index.npy", "point_cloud.pcd")
_AT_ONCE = 32768


def write_openlex3d(folder: Path, mapped: Map, mesh: Mesh) -> int:
    """Write a map as a dense prediction: an embedding a point.

    Background is left out: nothing was learnt there, and the benchmark tells what is missing from
    what is wrong.

    Args:
        folder: where `FILES` go, each whole or not at all: embeddings float32 [N, 512] of length 1
            in the space of the detector's texts (for YOLO-World that of CLIP ViT-B/32), index
            int64 [N], and the cloud with x, y, z, rgb.
        mapped: a map with semantics.
        mesh: its surface, of which the vertices are taken.

    Returns:
        N, the number of points.

    Raises:
        ProgroundError: all of the map is background.
    """
    embeddings, is_thing = _text_space(mapped, mesh.vertices_m)
    count = len(embeddings)
    if not count:
        raise ProgroundError(
            "all of the map is background", where=folder, todo="map more frames with regions"
        )
    for name, array in (("embeddings.npy", embeddings), ("index.npy", np.arange(count))):
        with written_whole(folder / name) as temporary, temporary.open("wb") as stream:
            np.save(stream, array)
    with written_whole(folder / "point_cloud.pcd") as temporary:
        temporary.write_bytes(pcd_bytes(mesh.vertices_m[is_thing], mesh.colors[is_thing]))
    return count


def _text_space(mapped: Map, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Embeddings [N, 512] as the texts' space has them, and which points they are of, bool [V]."""
    embeddings, chosen = [], []
    for start in range(0, len(points_m), _AT_ONCE):
        meaning = mapped.meaning(points_m[start : start + _AT_ONCE])
        if meaning.embeddings is None:
            raise ProgroundError(
                "the map keeps no embeddings",
                where=f"a map of kind {mapped.kind}",
                todo="export a map of kind neural, or something else of this one",
            )
        is_thing = meaning.background < BACKGROUND
        embeddings.append(meaning.embeddings[is_thing])
        chosen.append(is_thing)
    return np.concatenate(embeddings), np.concatenate(chosen)


def pcd_bytes(points_m: np.ndarray, colors: np.ndarray) -> bytes:
    """A point cloud as PCD 0.7, binary.

    Args:
        points_m: [N, 3].
        colors: uint8 [N, 3] RGB; the format packs them as 0x00rrggbb into the bits of a float.
    """
    count = len(points_m)
    rows = np.zeros(count, [("position", "<f4", 3), ("rgb", "<u4")])
    rows["position"] = points_m
    rows["rgb"] = colors.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    return header.encode() + rows.tobytes()
