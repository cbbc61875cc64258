"""What a replay tells of stands in the recording, at its time and with its value."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from proground_log.events import Event, FrameArrived, StepDone
from proground_log.telemetry.images import color_error, fit_width
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from tests.telemetry import telemetry_stream as stream
from tests.telemetry.telemetry_cells import Rows, rows_of, scalars

FRAMES = range(6)


def record(path: Path, events: Iterable[Event]) -> Path:
    """A whole recording of these events."""
    sink = TelemetrySink(path, recording_id="run", depth_far_m=4.0)
    for event in events:
        sink.on_event(event)
    sink.close()
    merge_segments([path], path)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "telemetry.rrd"
    return record(path, [*stream.of_frames(FRAMES), stream.FINISHED])


@pytest.fixture(scope="module")
def rows(recording: Path) -> Rows:
    return rows_of(recording)


def test_every_loss_of_every_step_is_there_bit_for_bit(rows: Rows) -> None:
    steps = len(FRAMES) * stream.STEPS_PER_FRAME
    for name in stream.losses(0):
        times, values = scalars(rows, f"/loss/{name}")
        assert values.tolist() == [stream.losses(step)[name] for step in range(steps)]
        assert times[:, 1].tolist() == list(range(steps))
        assert times[:, 0].tolist() == [step // stream.STEPS_PER_FRAME for step in range(steps)]
    assert times[4].tolist() == [1, 4, stream.FRAME_NS + stream.INGEST_NS + 2 * 7_000_003]


def test_more_steps_than_a_chunk_holds_arrive_whole(tmp_path: Path) -> None:
    steps = [e for e in stream.of_frames(range(400)) if isinstance(e, StepDone)]
    long = record(tmp_path / "long.rrd", steps)
    _, values = scalars(rows_of(long), "/loss/total")
    assert values.tolist() == [stream.losses(step)["total"] for step in range(len(steps))]


def test_the_buffer_is_drawn(rows: Rows) -> None:
    times, samples = scalars(rows, "/buffer/samples")
    assert samples.tolist() == [30, 60, 90, 100, 100, 100]
    assert times[:, 0].tolist() == list(FRAMES)
    assert scalars(rows, "/buffer/share")[1].tolist() == [0.3, 0.6, 0.9, 1.0, 1.0, 1.0]
    assert scalars(rows, "/buffer/evicted")[1].tolist() == [0, 0, 0, 20, 50, 80]
    for name in ("keyframes", "places", "water_level", "size_bytes", "inserted"):
        assert len(scalars(rows, f"/buffer/{name}")[1]) == len(FRAMES)


def test_the_mesh_is_the_one_given(rows: Rows) -> None:
    for index, (times, vertices) in enumerate(rows["/world/map/color", "Mesh3D:vertex_positions"]):
        mesh = stream.mesh(index)
        assert times[0] == index
        np.testing.assert_array_equal(np.float32(vertices), mesh.vertices_m)
        _, faces = rows["/world/map/color", "Mesh3D:triangle_indices"][index]
        np.testing.assert_array_equal(faces, mesh.faces)


def test_the_camera_moves_and_leaves_a_path(rows: Rows) -> None:
    positions = np.float32([stream.position_m(index) for index in FRAMES])
    poses = [value[0] for _, value in rows["/world/camera", "Transform3D:translation"]]
    np.testing.assert_array_equal(np.float32(poses), positions)
    strips = np.float32([v[0] for _, v in rows["/world/trajectory", "LineStrips3D:strips"]])
    np.testing.assert_array_equal(strips[:, 1], positions)
    np.testing.assert_array_equal(strips[1:, 0], positions[:-1])


def test_each_frame_keeps_its_own_camera(tmp_path: Path) -> None:
    arrived = [event for event in stream.of_frames(range(4)) if isinstance(event, FrameArrived)]
    wide = replace(stream.CAMERA, fx=40.0)
    events = [
        replace(event, frame=replace(event.frame, camera=camera))
        for event, camera in zip(arrived, [stream.CAMERA, wide, wide, stream.CAMERA], strict=True)
    ]
    pinholes = rows_of(record(tmp_path / "a.rrd", events))[
        "/world/camera", "Pinhole:image_from_camera"
    ]
    assert [value[0][0] for _, value in pinholes] == [60, 40, 40, 60]


def test_depth_views_share_a_range_and_keep_millimetres(rows: Rows) -> None:
    for which, name in (("input", "depth_m"), ("rendered", "rendered_depth_m")):
        entity = f"/view/{which}/depth"
        ranges = [value for _, value in rows[entity, "EncodedDepthImage:depth_range"]]
        assert ranges == [[[0.0, 4000.0]]] * len(FRAMES)
        for index, (_, blob) in enumerate(rows[entity, "EncodedDepthImage:blob"]):
            mm = cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_UNCHANGED)
            given_m = getattr(stream.view(index), name)
            np.testing.assert_allclose(mm / 1000.0, given_m, atol=0.00051)


def test_errors_are_dark_where_nothing_was_measured(rows: Rows) -> None:
    for _, blob in rows["/view/error/depth", "EncodedDepthImage:blob"]:
        mm = cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        assert (mm[:4] == 0).all()
        assert (np.abs(mm[4:].astype(int) - 50) <= 1).all()
    assert len(rows["/view/error/color", "EncodedImage:blob"]) == len(FRAMES)


def test_color_error_is_brighter_where_colours_differ_more() -> None:
    color = np.full((16, 24, 3), 100, dtype=np.uint8)
    rendered = color.copy()
    rendered[:, 8:16] += 20
    rendered[:, 16:] += 60
    color[:8, 16:] = 0
    heat = color_error(color, rendered).sum(axis=2)
    same, little, much, unseen = heat[12, 3], heat[12, 12], heat[12, 20], heat[2, 20]
    assert same < little < much
    assert unseen == same


def test_the_log_names_held_out_frames_and_digests(rows: Rows) -> None:
    texts = [value[0] for _, value in rows["/log", "TextLog:text"]]
    levels = [value[0] for _, value in rows["/log", "TextLog:level"]]
    said = dict(zip(texts, levels, strict=True))
    assert said["frame 3 is held out for evaluation"] == "INFO"
    assert said["keyframe 4: 30 samples in, 50 evicted"] == "DEBUG"
    assert sum(text.startswith("state after") for text in texts) == len(FRAMES)


def test_the_summary_is_a_table(rows: Rows) -> None:
    [(times, text)] = rows["/summary", "TextDocument:text"]
    assert times == ()
    assert "| frames | 6 |" in text[0]
    assert "| psnr db | 24.25 |" in text[0]
    assert "## stages" in text[0]


def test_the_blueprint_is_inside_and_no_wall_clock(recording: Path, rows: Rows) -> None:
    reader = RrdReader(recording)
    assert len(reader.blueprints()) == 1
    [entry] = reader.recordings()
    assert entry.recording_id == "run"
    # rows_of fails on any timeline but frame, step and sim_time; properties hold a start time.
    assert not any(entity.startswith("/__properties") for entity, _ in rows)


def test_images_shrink_and_keep_their_aspect() -> None:
    assert fit_width(np.zeros((480, 640, 3), dtype=np.uint8), 320).shape == (240, 320, 3)
    assert fit_width(np.zeros((48, 64), dtype=np.uint8), 320).shape == (48, 64)
