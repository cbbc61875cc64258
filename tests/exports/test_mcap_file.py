"""The map's MCAP, read back by the ROS 2 decoders of others, and by rerun."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from proground_log.exports.mcap_file import OBJECTS, OUTLINES, SURFACE, write_mcap
from tests.exports.scene import SIZES, scene_labels, scene_mesh, scene_objects

STAMP_NS = 1_700_000_000_123_456_789
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "rgb", "colors", "score", "label"],
        "formats": ["<f4", "<f4", "<f4", "<u4", "<u4", "<f4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24],
        "itemsize": 28,
    }
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "map.mcap"
    mesh = scene_mesh()
    write_mcap(path, mesh, scene_labels(mesh), scene_objects(mesh), stamp_ns=STAMP_NS)
    return path


@pytest.fixture(scope="module")
def messages(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        read = list(reader.iter_decoded_messages())
    assert {raw.log_time for _, _, raw, _ in read} == {STAMP_NS}
    return {channel.topic: message for _, channel, _, message in read}


def points_of(cloud: Any) -> np.ndarray:
    kinds = {4: "<u2", 6: "<u4", 7: "<f4"}
    described = {
        field.name: (field.offset, np.dtype(kinds[field.datatype])) for field in cloud.fields
    }
    assert described == {name: POINT.fields[name][1::-1] for name in POINT.names or ()}
    assert (cloud.point_step, cloud.row_step) == (POINT.itemsize, len(cloud.data))
    assert (cloud.header.stamp.sec, cloud.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
    return np.frombuffer(cloud.data, POINT, cloud.width)


def test_the_surface_is_a_cloud_with_colours_and_labels(messages: dict[str, Any]) -> None:
    mesh = scene_mesh()
    points = points_of(messages[SURFACE])
    xyz = np.stack([points[axis] for axis in "xyz"], axis=-1)
    np.testing.assert_array_equal(xyz, mesh.vertices_m)
    np.testing.assert_array_equal(points["label"], np.repeat([2, 1, 1, 0], 8))
    assert points["rgb"][0] == 200 << 16 | 100 << 8 | 50
    assert points["colors"][0] == 200 << 24 | 100 << 16 | 50 << 8 | 255


def test_each_object_has_a_box_and_a_name(messages: dict[str, Any]) -> None:
    markers = messages[OBJECTS].markers
    boxes = [marker for marker in markers if marker.ns == "boxes"]
    names = [marker.text for marker in markers if marker.ns == "names"]
    assert names == ["1 cup", "2 cup", "3 café table"]
    assert [marker.type for marker in markers] == [1, 9] * 3
    table = boxes[2]
    centre = [getattr(table.pose.position, axis) for axis in "xyz"]
    np.testing.assert_allclose(centre, (0.0, 0.0, 0.4), atol=1e-6)
    turn = Rotation.from_quat([getattr(table.pose.orientation, axis) for axis in "xyzw"])
    size = np.abs(turn.apply([getattr(table.scale, axis) for axis in "xyz"]))
    np.testing.assert_allclose(size, SIZES[0], atol=1e-5)
    assert boxes[0].color.r == pytest.approx(0x10 / 255)


def test_the_outlines_lie_on_the_edges_of_the_boxes(messages: dict[str, Any]) -> None:
    points = points_of(messages[OUTLINES])
    xyz = np.stack([points[axis] for axis in "xyz"], axis=-1)
    table = xyz[points["label"] == 2]
    np.testing.assert_allclose(table.min(axis=0), (-0.6, -0.4, 0.0), atol=1e-5)
    np.testing.assert_allclose(table.max(axis=0), (0.6, 0.4, 0.8), atol=1e-5)
    # On an edge two of three coordinates are at a side.
    at_side = np.isclose(np.abs(table - (0, 0, 0.4)), np.array(SIZES[0]) / 2, atol=1e-5)
    assert (at_side.sum(axis=1) >= 2).all()
    assert len(table) > 4 * (1.2 + 0.8 + 0.8) / 0.01


def test_other_decoders_know_the_same_types(path: Path) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with path.open("rb") as stream:
        for schema, _, raw in make_reader(stream).iter_messages():
            read = store.deserialize_cdr(raw.data, schema.name)
            assert bytes(store.serialize_cdr(read, schema.name))[4:] == raw.data[4:]


def test_the_same_map_gives_the_same_bytes(path: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    mesh = scene_mesh()
    write_mcap(again, mesh, scene_labels(mesh), scene_objects(mesh), stamp_ns=STAMP_NS)
    assert again.read_bytes() == path.read_bytes()
    with path.open("rb") as stream:
        (attachment,) = make_reader(stream).iter_attachments()
    assert json.loads(attachment.data) == {"0": "background", "1": "cup", "2": "café table"}


def test_a_map_without_objects_is_written_too(tmp_path: Path) -> None:
    mesh, path = scene_mesh(), tmp_path / "a.mcap"
    write_mcap(path, mesh, scene_labels(mesh), [], stamp_ns=0)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        read = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
    assert (read[OBJECTS].markers, read[OUTLINES].width) == ([], 0)


def test_rerun_shows_the_points_in_colour(path: Path, tmp_path: Path) -> None:
    recording = tmp_path / "map.rrd"
    rerun = [sys.executable, "-m", "rerun", "mcap"]
    subprocess.run([*rerun, "check", str(path)], check=True, capture_output=True)
    convert = [*rerun, "convert", str(path), "-o", str(recording)]
    subprocess.run(convert, check=True, capture_output=True)
    shown = {
        (str(chunk.entity_path), name)
        for chunk in RrdReader(recording).stream()
        for name in chunk.to_record_batch().schema.names
    }
    for topic in (SURFACE, OUTLINES):
        assert {(topic, "Points3D:positions"), (topic, "Points3D:colors")} <= shown
