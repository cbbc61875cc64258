"""Every export of a small run of the built-in room, and what cannot be exported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from pglog.export import export_command
from proground_log.api import open_run
from proground_log.errors import ProgroundError
from proground_log.exports.openlex3d import FILES
from proground_log.field.config import FieldConfig
from proground_log.log.reader import LogReader
from proground_log.mapping.map import BACKGROUND
from proground_log.mapping.neural.config import NeuralConfig, SamplingConfig, SemanticsConfig
from proground_log.mapping.neural.grounding import background_probability
from proground_log.navigation.floor_plan import CELL_M
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.perception.task import Task
from proground_log.run.settings import ReplayConfig, TelemetryConfig
from replay.session import replay

VOXEL_M = 0.08
TASK = Task("living", ("sofa", "bed", "table"), ("rug",))
CONFIG = ReplayConfig(
    steps=6,
    mapper=NeuralConfig(
        field=FieldConfig(log2_rows=14, levels=8, voxel_m=0.05),
        sampling=SamplingConfig(rays=256, uniform=12, near_surface=7),
        semantics=SemanticsConfig(rays=96, background_rays=48, samples=5),
    ),
    telemetry=TelemetryConfig(enabled=False),
)


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with meaning; read it, do not change it."""
    path = tmp_path_factory.mktemp("exports") / "run"
    log = LogReader(room_log)
    detector = SimulatedPerception(
        TASK, log.label_names, log.calibration.color, seed=0, strength=0.0
    )
    replay(room_log, path, replace(CONFIG, max_frames=8), perceiver=detector)
    return path


def read_pcd(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Positions [N, 3] and colours [N, 3] of a binary PCD, by the format's public description."""
    head, body = content.split(b"DATA binary\n", 1)
    about = dict(line.split(" ", 1) for line in head.decode().splitlines() if line[0] != "#")
    kinds = {("F", "4"): "<f4", ("U", "4"): "<u4"}
    fields = zip(*(about[key].split() for key in ("FIELDS", "TYPE", "SIZE")), strict=True)
    record = [(name, kinds[kind, size]) for name, kind, size in fields]
    assert int(about["WIDTH"]) * int(about["HEIGHT"]) == int(about["POINTS"])
    rows = np.frombuffer(body, record)
    assert len(rows) == int(about["POINTS"])
    packed = np.ascontiguousarray(rows["rgb"]).view(np.uint32)
    colors = np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=-1)
    return np.stack([rows[axis] for axis in "xyz"], axis=-1), colors


def test_openlex3d_finds_an_embedding_for_each_point(run: Path, tmp_path: Path) -> None:
    """As the toolbox reads it: `embeddings[index[i]]` is of point i; the cosine tells the text."""
    folder = tmp_path / "prediction"
    assert export_command(run, "openlex3d", output=folder, voxel_m=VOXEL_M) == 0
    embeddings, index = (np.load(folder / name) for name in FILES[:2])
    points_m, colors = read_pcd((folder / FILES[2]).read_bytes())
    assert embeddings.dtype == np.float32
    assert embeddings.ndim == 2
    assert len(points_m) == len(index) > 100
    of_points = embeddings[index]
    np.testing.assert_allclose(np.linalg.norm(of_points, axis=1), 1, atol=1e-5)

    opened = open_run(run)
    surface = opened.surface(VOXEL_M)
    semantics = opened.map.semantics_at(surface.mesh.vertices_m)
    seen = background_probability(semantics.scale_logits, semantics.uncertainty) < BACKGROUND
    np.testing.assert_array_equal(points_m, surface.mesh.vertices_m[seen])
    np.testing.assert_array_equal(colors, surface.mesh.colors[seen])
    # The cosine chooses the text that the map itself chooses, but for each level's offsets.
    texts = surface.description.texts
    logits, _ = surface.ask(texts)
    same = (of_points @ texts.T).argmax(axis=1) == logits[seen].argmax(axis=1)
    assert same.mean() > 0.9


def test_objects_are_written_as_pglog_objects_lists_them(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "objects.json"
    export_command(run, "objects", output=path, voxel_m=VOXEL_M)
    content = json.loads(path.read_text())
    assert content["prompts"] == ["sofa", "bed", "table"]
    assert content["up"] == [0.0, 0.0, 1.0]
    objects = open_run(run).objects(VOXEL_M)
    assert objects
    assert [row["label"] for row in content["objects"]] == [thing.label for thing in objects]
    for row, thing in zip(content["objects"], objects, strict=True):
        np.testing.assert_allclose(row["position_m"], thing.position_m, atol=6e-4)
        assert row["views"] == thing.views


def test_labels_reach_mesh_and_points(run: Path, tmp_path: Path) -> None:
    files = {"mesh": tmp_path / "mesh.ply", "points": tmp_path / "points.ply"}
    for what, path in files.items():
        export_command(run, what, output=path, voxel_m=VOXEL_M, labels=True)
    opened = open_run(run)
    first = opened.objects(VOXEL_M)[0]
    mesh = trimesh.load_mesh(files["mesh"], process=False)
    np.testing.assert_array_equal(mesh.vertices, opened.mesh(VOXEL_M).vertices_m)
    in_mesh = mesh.metadata["_ply_raw"]["vertex"]["data"]
    label = 1 + TASK.prompts.index(first.label)
    assert (in_mesh["label"][first.vertices] == label).all()
    points = trimesh.load(files["points"], process=False)
    distance_m, _ = cKDTree(points.vertices).query(mesh.vertices)
    assert distance_m.max() == 0


def test_the_others_are_written_and_say_what_is_in_them(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for what, name, says in (
        ("mesh", "map.glb", "faces"),
        ("occupancy", "floor.yaml", f"cells of {CELL_M} m"),
        ("mcap", "map.mcap", "objects"),
    ):
        path = tmp_path / name
        assert export_command(run, what, output=path, voxel_m=VOXEL_M) == 0
        assert path.stat().st_size
        printed = capsys.readouterr().out
        assert printed.startswith(f"{path}: ")
        assert printed.endswith(f"{says}\n")
    assert (tmp_path / "floor.pgm").read_bytes().startswith(b"P5")


def test_what_cannot_be_exported_is_refused_before_any_work(run: Path, tmp_path: Path) -> None:
    nowhere = tmp_path / "no run"
    for what, name, fault in (
        ("mesh", "a.obj", "mesh is not written as .obj"),
        ("objects", "objects", "without a suffix"),
        ("mesh", "a.ply", "no such run"),
    ):
        with pytest.raises(ProgroundError, match=fault):
            export_command(nowhere, what, output=tmp_path / name)
    (tmp_path / "floor.pgm").write_bytes(b"")
    (tmp_path / "lex").mkdir()
    (tmp_path / "lex" / "index.npy").write_bytes(b"")
    for what, name in (("occupancy", "floor.yaml"), ("openlex3d", "lex")):
        with pytest.raises(ProgroundError, match="--overwrite"):
            export_command(run, what, output=tmp_path / name)
    with pytest.raises(ProgroundError, match="voxels are 0"):
        export_command(run, "mesh", output=tmp_path / "a.ply", voxel_m=0.0)


def test_a_map_without_meaning_has_a_mesh_but_no_labels(room_log: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    replay(room_log, run, replace(CONFIG, max_frames=2, steps=4))
    export_command(run, "mesh", output=tmp_path / "a.ply", voxel_m=VOXEL_M)
    for what, name in (("points", "p.ply"), ("openlex3d", "lex"), ("objects", "o.json")):
        with pytest.raises(ProgroundError, match="pglog perceive"):
            export_command(run, what, output=tmp_path / name, voxel_m=VOXEL_M)
