"""Ways on the map of the built-in room, held against the room as it is."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import trimesh
from rerun.chunk import RrdReader
from scipy.spatial import cKDTree

from pglog.navigate import navigate_command
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.navigation.floor_plan import Robot
from proground_log.navigation.journey import Journey, navigate_surface
from proground_log.perception.perceive import perceive
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.telemetry.path_recording import draw_journey
from recorders.room import RoomSource
from replay.session import replay
from tests.query.asked_room import CONFIG, TASK, without_log
from tests.runs import navigate_run, surface_of_run

pytestmark = pytest.mark.slow

VOXEL_M = 0.06
ROBOT = Robot()
START = (3.5, 3.0)


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the room with perfect regions; read it, do not change it."""
    folder = tmp_path_factory.mktemp("navigate")
    reader = LogReader(room_log)
    perceiver = SimulatedPerception(
        TASK, reader.label_names, reader.calibration.color, seed=0, strength=0.0
    )
    perceive(room_log, perceiver, folder / "a.mcap", overwrite=False, progress=lambda *_: None)
    replay(folder / "a.mcap", folder / "run", CONFIG)
    return folder / "run"


@pytest.fixture(scope="module")
def to_bed(run: Path) -> Journey:
    return navigate_run(run, START, "bed", ROBOT, VOXEL_M)


def test_a_way_to_a_thing_ends_beside_it_and_touches_nothing(
    to_bed: Journey, room_log: Path
) -> None:
    (bed,) = (thing for thing in RoomSource(frames=1).objects if thing.class_name == "bed")
    goal_m = to_bed.route.corners_m[-1]
    nearest_m = goal_m.clip(bed.lower_m[:2], bed.upper_m[:2])
    assert np.linalg.norm(goal_m - nearest_m) < 0.5
    assert to_bed.plan.ground.axis_names == ("x", "y")
    assert abs(to_bed.plan.ground.floor_m) < 0.03
    content = LogReader(room_log).attachment(MESH_ATTACHMENT)
    assert content is not None
    truth = trimesh.load_mesh(BytesIO(content), file_type="ply", process=False)
    heights_m = truth.vertices[:, 2]
    band = truth.vertices[(heights_m > ROBOT.step_m) & (heights_m < ROBOT.height_m), :2]
    away_m, _ = cKDTree(band).query(to_bed.route.points_m)
    assert away_m.min() >= ROBOT.radius_m


def test_a_place_needs_no_meaning_and_no_log(run: Path, to_bed: Journey, tmp_path: Path) -> None:
    goal_m = to_bed.route.corners_m[-1]
    goal = (float(goal_m[0]), float(goal_m[1]))
    there = navigate_run(without_log(run, tmp_path), START, goal, ROBOT, VOXEL_M)
    np.testing.assert_allclose(there.route.corners_m[-1], goal_m)
    assert there.thing is None
    assert there.route.length_m == pytest.approx(to_bed.route.length_m, rel=0.05)


def test_what_cannot_be_found_or_reached_is_refused(run: Path) -> None:
    surface = surface_of_run(run, VOXEL_M)
    with pytest.raises(ProgroundError, match="nothing like 'toilet'"):
        navigate_surface(surface, START, "toilet", ROBOT)
    with pytest.raises(ProgroundError, match="outside the map"):
        navigate_surface(surface, START, (40.0, 1.0), ROBOT)
    with pytest.raises(ProgroundError, match="the robot cannot be there: something stands"):
        navigate_surface(surface, (1.0, 4.2), "bed", ROBOT)
    with pytest.raises(ProgroundError, match="voxels"):
        navigate_run(run, START, "bed", ROBOT, 0.0)
    with pytest.raises(ProgroundError, match="is not there"):
        navigate_run(run, START, "bed", ROBOT, VOXEL_M, log_path=run / "gone.mcap")
    with pytest.raises(ProgroundError, match="--from"):
        navigate_command(run, start="here", to="bed")


def test_the_command_prints_json_a_table_a_plan_and_a_recording(
    run: Path, to_bed: Journey, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    png, rrd = tmp_path / "plan.png", tmp_path / "drive.rrd"
    start = "{},{}".format(*START)
    assert navigate_command(run, start=start, to="bed", voxel_m=VOXEL_M, as_json=True) == 0
    printed = json.loads(capsys.readouterr().out)
    points_m = np.array(printed["points_m"])
    np.testing.assert_allclose(points_m[0, :2], START)
    np.testing.assert_allclose(points_m[:, 2], printed["floor_m"], atol=2e-3)
    steps_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(printed["length_m"], abs=0.05)
    assert steps_m.max() < 0.06
    assert len(printed["clearance_m"]) == len(points_m)
    assert min(printed["clearance_m"]) == printed["least_clearance_m"] >= ROBOT.radius_m
    assert printed["object"]["query"] == "bed"
    assert printed["goal"] == pytest.approx(points_m[-1, :2].tolist(), abs=2e-3)

    navigate_command(run, start=start, to="bed", voxel_m=VOXEL_M, png=png, rrd=rrd)
    table = capsys.readouterr().out
    assert f"{to_bed.route.length_m:.2f} m" in table
    assert str(png) in table
    assert png.read_bytes().startswith(b"\x89PNG")
    for output in ({"png": png}, {"rrd": rrd}):
        with pytest.raises(ProgroundError, match="--overwrite"):
            navigate_command(run, start=start, to="bed", **output)


def test_in_the_recording_the_robot_drives_from_start_to_goal(
    to_bed: Journey, tmp_path: Path
) -> None:
    contents = []
    for name in ("a.rrd", "b.rrd"):
        draw_journey(tmp_path / name, to_bed)
        contents.append(positions(tmp_path / name))
    places_m, seconds = contents[0]
    np.testing.assert_array_equal(places_m, contents[1][0])
    np.testing.assert_allclose(places_m[[0, -1], :2], to_bed.route.corners_m[[0, -1]], atol=1e-5)
    assert seconds[0] == 0
    assert seconds[-1] == pytest.approx(to_bed.route.length_m / 0.5, rel=1e-3)
    assert (np.diff(seconds) >= 0).all()


def positions(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Where the robot is, [P, 3], and when, in seconds [P]."""
    for chunk in RrdReader(path).stream():
        batch = pa.record_batch(chunk.to_record_batch())
        if str(chunk.entity_path) == "/world/robot" and "drive" in chunk.timeline_names:
            seconds = np.array(batch.column("drive").cast(pa.int64()).to_pylist()) / 1e9
            name = next(n for n in batch.schema.names if n.endswith("translation"))
            return np.array([cell[0] for cell in batch.column(name).to_pylist()]), seconds
    raise AssertionError("the robot does not move")
