"""Names, mappings and labelled meshes: the published ones, made-up ones, and damaged ones."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.errors import ProgroundError
from proground_log.evaluation.label_lists import (
    candidates_of,
    plain,
    read_labelled_mesh,
    read_mapping,
    read_names,
    truth_of,
)
from proground_log.log.reader import LogReader
from proground_log.log.topics import MESH_ATTACHMENT
from tests.evaluation.labelled_ply import ROWS, ply


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_the_published_names_and_mapping(shared_data: Path) -> None:
    names = read_names(shared_data / "labels" / "NYUv2_objects.csv")
    mapping = read_mapping(shared_data / "labels" / "hm3dsem_full_mappings.csv")
    assert (len(names), names[0], names[-1]) == (894, "book", "torah")
    assert (len(mapping), sum(map(bool, mapping.values()))) == (1623, 1151)
    candidates = candidates_of(dict(enumerate(mapping)), names, mapping, excluded=())
    assert sum(index >= 0 for index in candidates.values()) == 1151
    judged = candidates_of(dict(enumerate(mapping)), names, mapping)
    dropped = {mapping[raw] for i, raw in enumerate(mapping) if judged[i] < 0 <= candidates[i]}
    assert {"wall", "door frame", "flashlight"} <= dropped
    assert not {"chair", "tablecloth", "garbage bin"} & dropped


def test_the_house_by_the_published_lists(shared_data: Path) -> None:
    house = shared_data / "aws_small_house_labelled"
    names = read_names(shared_data / "labels" / "NYUv2_objects.csv")
    mapping = read_mapping(shared_data / "labels" / "hm3dsem_full_mappings.csv")
    classes = json.loads((house / "info_semantic.json").read_text())["classes"]
    label_names = {entry["id"]: entry["name"] for entry in classes}
    number = {name: label for label, name in label_names.items()}
    candidates = candidates_of(label_names, names, mapping)
    assert names[candidates[number["tv"]]] == "television"
    assert names[candidates[number["nightstand"]]] == "night stand"
    assert names[candidates[number["chair"]]] == "chair"
    assert {candidates[number[name]] for name in ("wall", "floor", "void", "dumbbell")} == {-1}

    content = (house / "mesh_semantic_observed.ply").read_bytes()
    vertices_m, labels, instances = read_labelled_mesh(content, where=house)
    mesh = trimesh.load_mesh(BytesIO(content), file_type="ply", process=False)
    np.testing.assert_array_equal(vertices_m, mesh.vertices)
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(labels, raw["label"])
    np.testing.assert_array_equal(instances, raw["instance"])
    truth = truth_of(labels, candidates)
    chairs = labels == number["chair"]
    assert chairs.any()
    assert set(truth[chairs]) == {names.index("chair")}
    assert set(truth[labels == number["wall"]]) == {-1}


def test_the_mesh_of_the_room(room_log: Path) -> None:
    reader = LogReader(room_log)
    content = reader.attachment(MESH_ATTACHMENT)
    assert content is not None
    vertices_m, labels, instances = read_labelled_mesh(content, where=room_log)
    assert len(vertices_m) == len(labels) > 1000
    assert instances is not None
    assert set(labels) <= set(reader.label_names)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("names.txt", "chair\n\n  coffee   table \nTV-set\n"),
        ("names.txt", "\ufeffchair\r\ncoffee table\r\nTV-set"),
        ("names.csv", "nyuId,nyuClass\r\n1,chair\r\n2,coffee table\r\n3,TV-set"),
        ("names.CSV", '\ufeffname\nchair\n"coffee table"\nTV-set\n'),
    ],
)
def test_names_are_read_in_order(name: str, content: str, tmp_path: Path) -> None:
    assert read_names(written(tmp_path / name, content)) == ("chair", "coffee table", "TV-set")


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("names.txt", "", "has no names"),
        ("names.csv", "", "has no column of names"),
        ("names.csv", "nyuClass\n", "has no column of names"),
        ("names.csv", "id,thing\n1,chair\n", "has no column of names"),
        ("names.csv", 'name\n"chair', "is no CSV"),
        ("names.txt", "coffee table\ncoffee-table\n", "'coffee-table' twice"),
        ("names.txt", b"\xff\xfe\x00chair", "is no text"),
    ],
)
def test_files_that_are_no_names_are_refused(
    name: str, content: str | bytes, what: str, tmp_path: Path
) -> None:
    with pytest.raises(ProgroundError, match=what):
        read_names(written(tmp_path / name, content))


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("", "no columns category and nyuClass"),
        ("raw,nyuClass\na,b\n", "no columns category and nyuClass"),
        ("category,nyuClass\nTea-pot,pot\ntea pot,kettle\n", "maps 'tea pot' to 'pot' and to"),
    ],
)
def test_files_that_are_no_mapping_are_refused(content: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match=what):
        read_mapping(written(tmp_path / "mapping.csv", content))


def test_missing_files_are_named(tmp_path: Path) -> None:
    for read in (read_names, read_mapping):
        with pytest.raises(ProgroundError, match="no such file"):
            read(tmp_path / "nothing.csv")


def test_labels_find_their_candidates_by_any_spelling() -> None:
    label_names = {0: "void", 3: "Coffee_Table", 4: "wall-cabinet", 7: "settee", 9: "nothing"}
    names = ("sofa", "coffee table", "wall cabinet", "settee")
    mapping = {"settee": "sofa", "nothing": ""}
    assert candidates_of(label_names, names) == {0: -1, 3: 1, 4: -1, 7: 3, 9: -1}
    assert candidates_of(label_names, names, mapping) == {0: -1, 3: 1, 4: -1, 7: 0, 9: -1}
    assert candidates_of(label_names, names, excluded=())[4] == 2


def test_what_is_excluded_is_judged_by_the_mapped_name() -> None:
    names = ("stairs", "chair")
    assert candidates_of({1: "steps", 2: "wall chair"}, names, {"steps": "stairs"}) == {
        1: -1,
        2: -1,
    }
    assert candidates_of({1: "wall chair"}, names, {"wall chair": "chair"}) == {1: 1}


@given(st.text(max_size=20))
def test_plain_names_stay_as_they_are(name: str) -> None:
    assert plain(plain(name)) == plain(name) == plain(f" {name}_")


def test_labels_become_candidates_and_unknown_ones_nothing() -> None:
    labels = np.array([7, 0, 7, 65535, 3], np.uint16)
    np.testing.assert_array_equal(truth_of(labels, {7: 2, 3: 0, 0: -1}), [2, -1, 2, -1, 0])
    assert truth_of(labels[:0], {7: 2}).shape == (0,)


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian", "ascii"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("faces", [True, False])
def test_a_mesh_reads_the_same_in_every_form(order: str, newline: str, faces: bool) -> None:
    vertices_m, labels, instances = read_labelled_mesh(ply(order, newline, faces), where="made up")
    np.testing.assert_array_equal(vertices_m, [[row[0], row[2], row[3]] for row in ROWS])
    np.testing.assert_array_equal(labels, [3, -1, 300])
    assert instances is not None
    np.testing.assert_array_equal(instances, [9, 255, 0])


def test_a_mesh_may_do_without_instances() -> None:
    other = ply().replace(b"instance", b"n_views ")
    assert read_labelled_mesh(other, where="made up")[2] is None


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (b"ply\n", b"plx\n", "is no PLY"),
        (b"end_header", b"end_of_it!", "is no PLY"),
        (b" label", b" lebal", "have no label"),
        (b"property double y", b"property double w", "have no y"),
        (b"element vertex 3", b"element vertex 9", "ends before its vertices do"),
        (b"element vertex 3", b"element vertex " + b"9" * 11, "ends before its vertices do"),
        (b"element vertex 3", b"element vertex " + b"9" * 5000, "header that cannot be read"),
        (b"element vertex", b"element edge", "does not begin with vertices"),
        (b"float z", b"floot z", "header that cannot be read"),
        (b"float z", b"float x", "twice"),
        (b"format binary_little", b"format binary_middle", "header that cannot be read"),
        (np.float32(0.125).tobytes(), np.float32("nan").tobytes(), "nowhere"),
    ],
)
def test_a_damaged_mesh_is_refused(old: bytes, new: bytes, what: str) -> None:
    content = ply()
    assert content.count(old) == 1
    with pytest.raises(ProgroundError, match=what):
        read_labelled_mesh(content.replace(old, new), where="made up")


def test_labels_must_be_whole_numbers() -> None:
    as_floats = ply("ascii").replace(b"int16 label", b"float label")
    assert read_labelled_mesh(as_floats, where="made up")[1].tolist() == [3, -1, 300]
    for wrong, what in ((b" 300.5 ", "whole"), (b" nan ", "whole"), (b" chair ", "damaged")):
        with pytest.raises(ProgroundError, match=what):
            read_labelled_mesh(as_floats.replace(b" 300 ", wrong), where="made up")


@settings(max_examples=300, deadline=None)
@given(data=st.data(), order=st.sampled_from(["binary_little_endian", "ascii"]))
def test_damage_of_any_kind_is_told_or_harmless(data: st.DataObject, order: str) -> None:
    content = bytearray(ply(order))
    for _ in range(data.draw(st.integers(0, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(content)))
    try:
        vertices_m, labels, _ = read_labelled_mesh(bytes(content[:end]), where="made up")
    except ProgroundError:
        return
    assert vertices_m.shape == (len(labels), 3)
    assert np.isfinite(vertices_m).all()
