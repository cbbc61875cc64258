"""The library from Python: the examples run, and what they use gives what the commands give."""

from __future__ import annotations

import csv
import io
import runpy
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image

import proground_log as pg
from proground_log.mapping.map_file import load_map
from proground_log.query.mesh import extract_mesh
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import bits_float, read_ledger

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[1] / "examples"
FRAMES, BUDGET_MS = 8, 420
VOXEL_M = 0.08


def run_example(name: str, *arguments: object) -> str:
    """Run an example as a script in this process; returns what it prints."""
    printed = io.StringIO()
    with patch.object(sys, "argv", [name, *map(str, arguments)]), redirect_stdout(printed):
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return printed.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log and a run, made by the first two examples."""
    folder = tmp_path_factory.mktemp("room")
    looked = run_example("1_record_and_look.py", folder, FRAMES)
    assert f"room: {FRAMES} frames of 320 x 240 pixels" in looked
    assert "sofa" in looked
    replayed = run_example("2_replay_with_a_budget.py", folder, BUDGET_MS)
    assert "semantic: " in replayed
    return folder


@pytest.fixture(scope="module")
def run(folder: Path) -> pg.Run:
    return pg.open_run(folder / "run")


def test_every_example_is_run_here() -> None:
    assert [path.name[0] for path in sorted(EXAMPLES.glob("*.py"))] == ["1", "2", "3", "4"]


def test_an_example_asks_and_renders(folder: Path) -> None:
    printed = run_example("3_query_and_render.py", folder, "bed")
    assert printed.startswith("bed: ")
    assert Image.open(folder / "view.png").size == (160, 120)


def test_an_example_lists_objects_and_finds_a_way(folder: Path) -> None:
    printed = run_example("4_objects_and_a_way.py", folder)
    rows = list(csv.DictReader((folder / "objects.csv").read_text().splitlines()))
    assert {row["object"] for row in rows} <= {"sofa", "bed", "table", "chair"}
    assert "way" in printed


def test_importing_costs_next_to_nothing() -> None:
    heavy = ["torch", "numpy", "rerun", "cv2", "scipy", "replay.session"]
    code = f"import sys, proground_log; print([m for m in {heavy} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert found.stdout == "[]\n"
    with pytest.raises(AttributeError, match="no attribute 'opn_run'"):
        _ = pg.opn_run
    assert all(hasattr(pg, name) for name in pg.__all__)


def test_a_log_gives_its_frames_and_cameras(folder: Path) -> None:
    log = pg.open_log(str(folder / "room.mcap"))
    frames = list(log.frames())
    assert len(frames) == len(log) == FRAMES
    assert frames[3].depth_m.shape == (log.calibration.depth.height, log.calibration.depth.width)
    assert log.label_names[0] == "nothing"
    with pytest.raises(pg.ProgroundError, match="no such file"):
        pg.open_log(folder / "nothing.mcap")


def test_losses_are_those_of_the_ledger(run: pg.Run) -> None:
    steps = [e for e in read_ledger(RunFolder(run.path).ledger) if e["event"] == "step"]
    losses = run.losses
    assert {len(column) for column in losses.values()} == {len(steps)}
    np.testing.assert_array_equal(losses["step"], np.arange(len(steps)))
    for number in (0, len(steps) // 2, len(steps) - 1):
        for term, bits in steps[number]["losses"].items():
            assert losses[term][number] == bits_float(bits)
    assert len(list(run.events("done"))) == FRAMES
    assert run.manifest.config.simulation.budget_ms == BUDGET_MS


def test_a_term_that_a_step_lacks_is_not_a_number(
    run: pg.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = {"event": "step", "step": 0, "frame": 0, "sim_time_ns": 0}
    steps = [{**number, "losses": {"rgb": "3f800000"}}, {**number, "losses": {"depth": "40000000"}}]
    opened = pg.open_run(run.path)
    monkeypatch.setattr("proground_log.run.history.read_ledger", lambda _: iter(steps))
    np.testing.assert_array_equal(opened.losses["rgb"], [1.0, np.nan])
    np.testing.assert_array_equal(opened.losses["depth"], [np.nan, 2.0])


def test_mesh_and_view_are_those_of_the_map(run: pg.Run) -> None:
    content = load_map(RunFolder(run.path).map)
    mesh, expected = run.mesh(VOXEL_M), extract_mesh(content, VOXEL_M)
    np.testing.assert_array_equal(mesh.vertices_m, expected.vertices_m)
    np.testing.assert_array_equal(mesh.colors, expected.colors)
    assert run.surface(VOXEL_M).mesh is run.mesh(VOXEL_M)
    assert len(run.mesh(2 * VOXEL_M).vertices_m) < len(mesh.vertices_m)
    (frame,) = run.log.frames([2])
    camera = run.log.calibration.depth.scaled_to_width(40)
    view = run.render(frame.world_from_camera, camera)
    theirs = content.render(camera, frame.world_from_camera)
    np.testing.assert_array_equal(view.depth_m, theirs.depth_m)
    assert view.color.shape == (30, 40, 3)
    mirrored = np.diag([1.0, 1.0, -1.0, 1.0])
    with pytest.raises(pg.ProgroundError, match="it mirrors"):
        run.render(mirrored, camera)


def test_objects_number_the_vertices_of_the_mesh(run: pg.Run) -> None:
    vertices_m = run.mesh(VOXEL_M).vertices_m
    objects = run.objects(VOXEL_M)
    assert objects
    for thing in objects:
        assert thing.label in run.prompts
        # The replay itself ran the detector: no log says who saw what.
        assert thing.views is None
        inside_m = np.abs(vertices_m[thing.vertices] - thing.box.centre_m) @ np.abs(
            thing.box.axes.T
        )
        # Boxes leave out two percent on either side of three axes.
        assert (inside_m <= thing.box.extent_m / 2 + 0.5).mean() > 0.85


def test_a_log_that_has_moved_can_be_given(folder: Path, run: pg.Run, tmp_path: Path) -> None:
    moved = tmp_path / "moved.mcap"
    moved.write_bytes((folder / "room.mcap").read_bytes())
    assert len(pg.open_run(str(run.path), log=str(moved)).log) == FRAMES
    with pytest.raises(pg.ProgroundError, match="no such run"):
        pg.open_run(tmp_path / "nowhere")


def test_another_log_is_refused_where_a_log_is_needed(run: pg.Run, room_log: Path) -> None:
    other = pg.open_run(run.path, log=room_log)
    assert len(other.mesh(VOXEL_M).vertices_m) == len(run.mesh(VOXEL_M).vertices_m)
    for ask in (lambda: other.log, lambda: other.objects(VOXEL_M)):
        with pytest.raises(pg.ProgroundError, match="is not the log"):
            ask()
