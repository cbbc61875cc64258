"""PLY and GLB, read back by readers of other make."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh

from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.exports.glb import write_glb
from proground_log.exports.ply import write_mesh_ply, write_points_ply
from tests.exports.scene import TASK, UP, scene_labels, scene_mesh

MESH = scene_mesh()
LABELS = scene_labels(MESH)
EXPECTED = np.repeat([2, 1, 1, 0], 8)


def ply_rows(content: bytes) -> tuple[str, np.ndarray]:
    """Header and vertices of a binary PLY, by its public description."""
    header, body = content.split(b"end_header\n", 1)
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    kinds = {"float": "<f4", "uchar": "u1", "ushort": "<u2"}
    vertices = header.decode("ascii").split("element vertex ")[1].split("element")[0]
    record = [(name, kinds[kind]) for kind, name in re.findall(r"property (\w+) (\w+)", vertices)]
    return header.decode("ascii"), np.frombuffer(body, record, int(vertices.split()[0]))


def test_vertices_have_the_label_of_the_object_that_they_are_of() -> None:
    np.testing.assert_array_equal(LABELS.labels, EXPECTED)
    np.testing.assert_array_equal(LABELS.instances, np.repeat([3, 1, 2, 0], 8))
    np.testing.assert_array_equal(LABELS.scores, np.repeat([0.25, 0.75, 0.5, 0.0], 8))
    assert LABELS.names == ("background", *TASK.prompts)
    colors = LABELS.colors(MESH.colors)
    assert (colors[8:24] == (0x10, 0x20, 0x30)).all()
    assert (colors[24:] == 63).all()  # 0.7 of the 90 that it has itself.


def test_a_mesh_as_ply(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_mesh_ply(path, MESH, None)
    read = trimesh.load_mesh(BytesIO(path.read_bytes()), file_type="ply", process=False)
    np.testing.assert_array_equal(read.vertices, MESH.vertices_m)
    np.testing.assert_array_equal(read.faces, MESH.faces)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], MESH.colors)
    _, rows = ply_rows(path.read_bytes())
    np.testing.assert_array_equal(rows["nz"], MESH.normals[:, 2])
    assert "label" not in rows.dtype.names


def test_labels_names_and_scores_are_in_the_ply(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_mesh_ply(path, MESH, LABELS)
    header, rows = ply_rows(path.read_bytes())
    np.testing.assert_array_equal(rows["label"], EXPECTED)
    np.testing.assert_array_equal(rows["score"], LABELS.scores)
    colors = np.stack([rows[name] for name in ("red", "green", "blue")], axis=-1)
    np.testing.assert_array_equal(colors, LABELS.colors(MESH.colors))
    named = re.findall("^comment label (.*)$", header, re.MULTILINE)
    assert named == ["0 background", "1 cup", r"2 caf\xe9 table"]
    vertices_m, labels, instances = read_labelled_mesh(path.read_bytes(), where=path)
    np.testing.assert_array_equal(vertices_m, MESH.vertices_m)
    np.testing.assert_array_equal(labels, EXPECTED)
    assert instances is not None
    assert set(instances) == {0, 1, 2, 3}


def test_a_labelled_point_cloud(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_points_ply(path, MESH, LABELS)
    _, rows = ply_rows(path.read_bytes())
    xyz, rgb = ("x", "y", "z"), ("red", "green", "blue", "alpha")
    assert rows.dtype.names == (*xyz, *rgb, "label", "instance", "score")
    np.testing.assert_array_equal(rows["label"], EXPECTED)
    colors = np.stack([rows[name] for name in rgb[:3]], axis=-1)
    np.testing.assert_array_equal(colors, MESH.colors)


@pytest.mark.parametrize("up", [UP, np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])])
def test_in_a_glb_up_is_y(tmp_path: Path, up: np.ndarray) -> None:
    path = tmp_path / "a.glb"
    write_glb(path, MESH, up, None)
    scene = trimesh.load_scene(BytesIO(path.read_bytes()), file_type="glb", process=False)
    shown = scene.to_mesh()
    np.testing.assert_allclose(shown.vertices[:, 1], MESH.vertices_m @ up, atol=1e-6)
    assert shown.volume == pytest.approx(trimesh.Trimesh(MESH.vertices_m, MESH.faces).volume)
    np.testing.assert_array_equal(shown.visual.vertex_colors[:, :3], MESH.colors)
    np.testing.assert_allclose(scene.geometry["surface"].vertices, MESH.vertices_m)


def test_a_glb_names_the_colours_of_its_labels(tmp_path: Path) -> None:
    one, two = tmp_path / "a.glb", tmp_path / "b.glb"
    write_glb(one, MESH, UP, LABELS)
    write_glb(two, MESH, UP, LABELS)
    assert one.read_bytes() == two.read_bytes()
    scene = trimesh.load_scene(one, process=False)
    (shown,) = scene.geometry.values()
    named = shown.metadata["labels"]
    assert list(named) == ["cup", "café table"]
    assert named["cup"] == "#102030"
    np.testing.assert_array_equal(shown.visual.vertex_colors[8, :3], (0x10, 0x20, 0x30))
