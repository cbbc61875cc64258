"""What `pglog view` shows of a log."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from rerun.chunk import RrdReader

from proground_log.camera import Calibration
from proground_log.frame import SensorFrame
from proground_log.palette import label_colors
from proground_log.telemetry.log_recording import write_log_recording
from tests.writers.small_source import CAMERA, LABEL_NAMES, SmallSource, write_log

Cells = dict[tuple[str, str], list[Any]]


def cells_of(path: Path) -> Cells:
    """The values by entity and component, in the order of their frames."""
    held: dict[tuple[str, str], list[tuple[int, Any]]] = defaultdict(list)
    for chunk in RrdReader(path).stream():
        batch = pa.record_batch(chunk.to_record_batch())
        is_timed = "frame" in chunk.timeline_names
        frames = batch.column("frame").to_pylist() if is_timed else [-1] * batch.num_rows
        for name in batch.schema.names:
            if name == "time" or name.endswith("RowId"):
                continue
            values = zip(frames, batch.column(name).to_pylist(), strict=True)
            held[str(chunk.entity_path), name] += [v for v in values if v[1] is not None]
    return {
        key: [value for _, value in sorted(cells, key=lambda cell: cell[0])]
        for key, cells in held.items()
    }


@pytest.fixture(scope="module")
def frames() -> list[SensorFrame]:
    """Frames with labels, the last two through another lens, of other sizes."""
    source = SmallSource(4, with_labels=True)
    frames = [source.frame(index) for index in range(4)]
    refocused = Calibration.registered(replace(CAMERA, fx=33.0))
    return frames[:2] + [replace(frame, calibration=refocused) for frame in frames[2:]]


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory, frames: list[SensorFrame]) -> Cells:
    folder = tmp_path_factory.mktemp("view")
    log = write_log(folder / "a.mcap", SmallSource(4, with_labels=True), frames=frames)
    write_log_recording(log, folder / "a.rrd")
    return cells_of(folder / "a.rrd")


def test_the_whole_way_is_there_at_once(cells: Cells, frames: list[SensorFrame]) -> None:
    (strips,) = cells["/world/trajectory", "LineStrips3D:strips"]
    way = [frame.world_from_camera[:3, 3] for frame in frames]
    np.testing.assert_allclose(strips[0], way, atol=1e-6)
    places = [value[0] for value in cells["/world/camera", "Transform3D:translation"]]
    np.testing.assert_allclose(places, way, atol=1e-6)


def test_the_surface_is_what_was_measured_in_metres(
    cells: Cells, frames: list[SensorFrame]
) -> None:
    (points,) = cells["/world/surface", "Points3D:positions"]
    (colors,) = cells["/world/surface", "Points3D:colors"]
    assert len(points) == len(colors) > 1000
    distances_m = [
        np.linalg.norm(np.array(points) - frame.world_from_camera[:3, 3], axis=1)
        for frame in frames
    ]
    # Depth of the fixture is from 0.5 to 2.5 m along z, and its camera sees 28 degrees aside.
    assert np.min(distances_m, axis=0).max() < 2.5 / np.cos(np.radians(40))


def test_each_frame_has_its_own_camera(cells: Cells) -> None:
    pinholes = cells["/world/camera/color", "Pinhole:image_from_camera"]
    assert [value[0][0] for value in pinholes] == [30, 33]


def test_images_are_as_they_were_recorded(cells: Cells, frames: list[SensorFrame]) -> None:
    for blob, frame in zip(cells["/world/camera/color", "EncodedImage:blob"], frames, strict=True):
        assert bytes(blob[0]) == frame.color
    for pixels, frame in zip(cells["/depth", "DepthImage:buffer"], frames, strict=True):
        assert bytes(pixels[0]) == frame.depth.tobytes()


def test_labels_have_their_names_and_colours(cells: Cells) -> None:
    (context,) = cells["/labels", "AnnotationContext:context"]
    infos = [entry["class_description"]["info"] for entry in context[0]]
    named = {info["id"]: info["label"] for info in infos if info["label"]}
    assert named == LABEL_NAMES
    colors = label_colors(max(LABEL_NAMES) + 1)
    for info in infos:
        assert [info["color"] >> shift & 255 for shift in (24, 16, 8)] == colors[
            info["id"]
        ].tolist()
    for names in cells["/labels/names", "Points2D:labels"]:
        assert sorted(names) == sorted(LABEL_NAMES.values())
