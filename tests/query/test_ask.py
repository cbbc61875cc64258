"""Asking the map of a perceived room: what is found lies where the room has it."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from PIL import Image

from pglog.query import query_command
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.mapping.map_file import load_map
from proground_log.mapping.neural.grounding import vertex_logits
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.objects import SceneObject
from proground_log.perception.builtin_texts import COMMON_SHARE, BuiltinTexts, common_direction
from proground_log.perception.map_texts import Texts
from proground_log.perception.onnx.image_encoder import SIDE, pixel_values
from proground_log.perception.perceive import perceive
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.query.ask import NOT_MARGIN, Answer
from proground_log.query.grounding import MARGIN
from proground_log.query.image_query import ImageQuery, background_crops
from proground_log.query.sightings import LEAST_AREA_M2
from proground_log.query.surface import Surface
from proground_log.regions import EMBEDDING_WIDTH
from proground_log.run.folder import RunFolder
from proground_log.streams import stream
from recorders.room import RoomSource
from replay.session import replay
from tests.query.asked_room import CONFIG, TASK, without_log
from tests.runs import query_run
from tests.telemetry.telemetry_cells import rows_of

pytestmark = pytest.mark.slow

VOXEL_M = 0.06


@pytest.fixture(scope="module")
def perceived_log(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room with perfect regions: errors of perception are not what is tested here."""
    path = tmp_path_factory.mktemp("query") / "room.mcap"
    reader = LogReader(room_log)
    perceiver = SimulatedPerception(
        TASK, reader.label_names, reader.calibration.color, seed=0, strength=0.0
    )
    perceive(room_log, perceiver, path, overwrite=False, progress=lambda *_: None)
    return path


@pytest.fixture(scope="module")
def run(perceived_log: Path) -> Path:
    """A finished run of it; read it, do not change it."""
    path = perceived_log.with_name("run")
    replay(perceived_log, path, CONFIG)
    return path


@pytest.fixture(scope="module")
def encoder(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_encoder(tmp_path_factory.mktemp("encoder") / "clip.onnx", LogReader(room_log))


@pytest.fixture(scope="module")
def answered(run: Path) -> tuple[Surface, dict[str, Answer]]:
    names = ["sofa", "couch", "bed", "table", "toilet"]
    surface, answers = query_run(run, names, VOXEL_M, 5)
    assert [answer.query for answer in answers] == names
    return surface, {answer.query: answer for answer in answers}


def size(thing: SceneObject) -> int:
    return len(thing.vertices)


def answer_of(run: Path, text: str) -> Answer:
    _, (answer,) = query_run(run, [text], VOXEL_M, 5)
    return answer


def distance_m(point_m: np.ndarray, class_name: str) -> float:
    """From a point to the nearest true box of a class."""
    boxes = [
        np.array([thing.lower_m, thing.upper_m])
        for thing in RoomSource(frames=1).objects
        if thing.class_name == class_name
    ]
    return min(float(np.linalg.norm(point_m - np.clip(point_m, *box))) for box in boxes)


@pytest.mark.parametrize(
    ("query", "class_name"),
    [("sofa", "sofa"), ("couch", "sofa"), ("bed", "bed"), ("table", "table")],
)
def test_large_things_are_found_where_they_are(
    answered: tuple[Surface, dict[str, Answer]], query: str, class_name: str
) -> None:
    surface, answers = answered
    answer = answers[query]
    best = answer.things[0]
    assert distance_m(best.position_m, class_name) < 0.3
    largest = max(answer.things, key=size)
    assert distance_m(largest.position_m, class_name) < 0.3
    assert np.linalg.norm(largest.box.extent_m) > 0.5
    for thing in answer.things:
        assert len(thing.vertices) >= LEAST_AREA_M2 / VOXEL_M**2
        assert thing.score >= answer.measure.threshold
        points_m = surface.mesh.vertices_m[thing.vertices]
        assert (points_m.min(axis=0) <= thing.position_m).all()
    scores = [thing.score for thing in answer.things]
    assert scores == sorted(scores, reverse=True)


def test_things_are_the_objects_of_the_map_scored_by_what_the_detector_saw(
    answered: tuple[Surface, dict[str, Answer]],
) -> None:
    """Against the definition, region by region and level by level."""
    surface, answers = answered
    assert surface.sightings is not None
    listed = {int(thing.vertices[0]): thing for thing in surface.objects}
    for name in ("couch", "bed"):
        (text,) = BuiltinTexts().embed([name])
        assert answers[name].things
        for thing in answers[name].things:
            known = listed[int(thing.vertices[0])]
            assert (known.label, known.views, known.box) == (thing.label, thing.views, thing.box)
            np.testing.assert_array_equal(known.vertices, thing.vertices)
            fits = []
            for witness in thing.witnesses:
                embedding = surface.sightings.embeddings[[witness]]
                level = int(surface.sightings.levels[witness])
                logit = surface.description.heads.logits(embedding, level, text[None])[0, 0]
                fits.append(1 / (1 + math.exp(-logit)))
            assert thing.score == pytest.approx(np.mean(fits), abs=1e-5)


def test_without_its_log_a_map_still_answers(
    run: Path, answered: tuple[Surface, dict[str, Answer]], tmp_path: Path
) -> None:
    elsewhere = without_log(run, tmp_path)
    surface, (bed,) = query_run(elsewhere, ["bed"], VOXEL_M, 5)
    assert surface.sightings is None
    assert bed.things[0].views is None
    assert distance_m(bed.things[0].position_m, "bed") < 0.3
    # What the map says of its vertices needs no log.
    _, answers = answered
    np.testing.assert_allclose(bed.scores, answers["bed"].scores, atol=1e-5)


def test_a_synonym_scores_below_its_prompt(answered: tuple[Surface, dict[str, Answer]]) -> None:
    _, answers = answered
    assert 0.2 < answers["couch"].best < answers["sofa"].best


def test_what_is_not_there_is_not_found(answered: tuple[Surface, dict[str, Answer]]) -> None:
    _, answers = answered
    assert answers["toilet"].things == ()
    assert answers["toilet"].best < answers["toilet"].measure.threshold


def neural_map(run: Path) -> NeuralMap:
    content = load_map(RunFolder(run).map)
    assert isinstance(content, NeuralMap)
    return content


def test_a_query_competes_with_the_prompts_and_with_nothing_else(
    run: Path, answered: tuple[Surface, dict[str, Answer]]
) -> None:
    """Against the definition, vertex by vertex and level by level."""
    surface, answers = answered
    content = neural_map(run)
    semantics = content.semantics_at(surface.mesh.vertices_m)
    description = surface.description
    texts = np.concatenate([description.texts, BuiltinTexts().embed(["couch"])])
    checked = 0
    for vertex in range(0, len(surface.mesh.vertices_m), 50):
        odds = np.exp(semantics.scale_logits[vertex].astype(np.float64))
        levels = odds[:3] / odds[:3].sum()
        logits = sum(
            levels[k] * description.heads.logits(semantics.embeddings[vertex][None], k, texts)[0]
            for k in range(3)
        )
        lead = logits[:-1].max() - logits[-1]
        nothing = (odds[3] / odds.sum() + semantics.uncertainty[vertex]) / 2
        if min(abs(lead - MARGIN), abs(nothing - 0.5)) < 1e-3:
            continue
        claims = lead < MARGIN and nothing < 0.5
        expected = 1 / (1 + math.exp(-logits[-1])) if claims else 0.0
        assert answers["couch"].scores[vertex] == pytest.approx(expected, abs=1e-4)
        checked += claims
    assert checked > 20


def test_answers_do_not_depend_on_the_other_queries(
    run: Path, answered: tuple[Surface, dict[str, Answer]]
) -> None:
    _, answers = answered
    _, (alone, again) = query_run(run, [" Sofa", "couch"], VOXEL_M, 2)
    np.testing.assert_allclose(alone.scores, answers["sofa"].scores, atol=1e-5)
    np.testing.assert_allclose(again.scores, answers["couch"].scores, atol=1e-5)
    assert [thing.label for thing in alone.things] == ["sofa"]


CELLS = 8


def pattern(name: str) -> np.ndarray:
    """A picture that stands for a class: a grid of colours."""
    colors = stream(0, name).integers(256, size=(CELLS, CELLS, 3)).astype(np.uint8)
    return colors.repeat(SIDE // CELLS, axis=0).repeat(SIDE // CELLS, axis=1)


def pooled(image: np.ndarray) -> np.ndarray:
    cells = pixel_values(image).reshape(3, CELLS, SIDE // CELLS, CELLS, SIDE // CELLS)
    return np.asarray(cells.mean(axis=(2, 4)).reshape(-1))


def image_embedding(shares: dict[str, float], draw: np.random.Generator) -> np.ndarray:
    """What CLIP would make of a picture that shows classes in these shares of its pixels.

    As with CLIP there is a gap to all texts, and much that has to do with neither.
    """
    texts = BuiltinTexts().embed(list(shares)) - common_direction() * COMMON_SHARE**0.5
    content = np.array(list(shares.values())) @ texts
    aside = draw.standard_normal(EMBEDDING_WIDTH) / EMBEDDING_WIDTH**0.5
    gap = stream(0, "gap").standard_normal(EMBEDDING_WIDTH) / EMBEDDING_WIDTH**0.5
    return 0.5 * content / np.linalg.norm(content) + 0.4 * aside + 0.7 * gap


def write_encoder(path: Path, reader: LogReader) -> Path:
    """An image encoder that is right about the patterns and about the pieces of a log's images."""
    draw = stream(0, "encoder")
    pictures = [pattern(name) for name in TASK.prompts]
    embeddings = [image_embedding({name: 1.0}, draw) for name in TASK.prompts]
    pictures += background_crops(reader)
    for sensor in reader.frames(range(len(reader))):
        assert sensor.labels is not None
        for band in np.array_split(sensor.labels, 2, axis=0):
            for labels in np.array_split(band, 2, axis=1):
                found = zip(*np.unique(labels, return_counts=True), strict=True)
                shares = {reader.label_names[label]: count / labels.size for label, count in found}
                embeddings.append(image_embedding(shares, draw))
    inputs = np.stack([pooled(picture) for picture in pictures]).astype(np.float64)
    weights = np.linalg.pinv(inputs) @ np.stack(embeddings)
    cell = [SIDE // CELLS] * 2
    nodes = [
        helper.make_node("AveragePool", ["pixel_values"], ["c"], kernel_shape=cell, strides=cell),
        helper.make_node("Flatten", ["c"], ["flat"]),
        helper.make_node("MatMul", ["flat", "weights"], ["embeddings"]),
    ]
    shapes = {"pixel_values": ["N", 3, SIDE, SIDE], "embeddings": ["N", EMBEDDING_WIDTH]}
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in shapes.items()
    ]
    tensor = numpy_helper.from_array(weights.astype(np.float32), "weights")
    graph = helper.make_graph(nodes, "image", ends[:1], ends[1:], [tensor])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, {"proground.contract": "1"})
    onnx.save(model, path)
    return path


@pytest.mark.parametrize("name", ["sofa", "bed", "table"])
def test_an_image_finds_what_it_shows(run: Path, encoder: Path, tmp_path: Path, name: str) -> None:
    Image.fromarray(pattern(name)).save(tmp_path / "thing.png")
    query = ImageQuery(tmp_path / "thing.png", encoder)
    _, (answer,) = query_run(run, [], VOXEL_M, 5, image=query)
    assert answer.query == "thing.png"
    assert distance_m(answer.things[0].position_m, name) < 0.3
    assert distance_m(max(answer.things, key=size).position_m, name) < 0.3
    assert answer.best >= answer.measure.threshold


def test_the_bank_is_cut_from_all_of_evenly_spaced_frames(room_log: Path) -> None:
    reader = LogReader(room_log)
    crops = list(background_crops(reader))
    assert len(crops) == 48
    for index, sensor in enumerate(reader.frames(range(12))):
        a, b, c, d = crops[4 * index : 4 * index + 4]
        whole = np.concatenate([np.concatenate([a, b], 1), np.concatenate([c, d], 1)])
        np.testing.assert_array_equal(whole, sensor.decode_color())


def test_the_log_of_an_image_query_must_be_the_runs(
    run: Path, encoder: Path, perceived_log: Path, room_log: Path, tmp_path: Path
) -> None:
    Image.fromarray(pattern("sofa")).save(tmp_path / "thing.png")
    query = ImageQuery(tmp_path / "thing.png", encoder)
    with pytest.raises(ProgroundError, match="is not the log"):
        query_run(run, [], VOXEL_M, 5, image=query, log_path=room_log)
    moved, elsewhere = tmp_path / "moved.mcap", without_log(run, tmp_path)
    shutil.copy(perceived_log, moved)
    with pytest.raises(ProgroundError, match="nowhere"):
        query_run(elsewhere, [], VOXEL_M, 5, image=query)
    _, (here,) = query_run(elsewhere, [], VOXEL_M, 5, image=query, log_path=moved)
    _, (there,) = query_run(run, [], VOXEL_M, 5, image=query)
    np.testing.assert_array_equal(here.scores, there.scores)


def test_what_cannot_be_answered_is_refused(run: Path, room_log: Path, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="does not know 'elephant'"):
        query_run(run, ["sofa", "elephant"], VOXEL_M, 5)
    with pytest.raises(ProgroundError, match="nothing to look for"):
        query_run(run, [], VOXEL_M, 5)
    with pytest.raises(ProgroundError, match="empty"):
        query_run(run, [" "], VOXEL_M, 5)
    with pytest.raises(ProgroundError, match="best 0"):
        query_run(run, ["sofa"], VOXEL_M, 0)
    for voxel_m in (0.0, math.nan):
        with pytest.raises(ProgroundError, match="voxels"):
            query_run(run, ["sofa"], voxel_m, 5)
    with pytest.raises(ProgroundError, match="both given"):
        query_run(run, ["sofa"], VOXEL_M, 5, texts=Texts(tmp_path / "a", tmp_path / "b"))
    (tmp_path / "no.png").write_bytes(b"\x89PNG\r\n\x1a\nnot at all")
    with pytest.raises(ProgroundError, match="cannot be read as an image"):
        query_run(run, [], VOXEL_M, 5, image=ImageQuery(tmp_path / "no.png", tmp_path / "e"))
    meaningless = tmp_path / "run"
    replay(room_log, meaningless, replace(CONFIG, max_frames=1, steps=1))
    with pytest.raises(ProgroundError, match="pglog perceive"):
        query_run(meaningless, ["sofa"], VOXEL_M, 5)


def test_the_command_prints_json_for_programs_and_a_table_for_people(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = ("bed", "toilet")
    assert query_command(run, texts, voxel_m=VOXEL_M, top_k=1, as_json=True) == 0
    printed = capsys.readouterr().out
    bed, toilet = json.loads(printed)
    assert (bed["query"], toilet["query"], toilet["things"]) == ("bed", "toilet", [])
    (thing,) = bed["things"]
    assert distance_m(np.array(thing["position_m"]), "bed") < 0.3
    extent_m = np.subtract(thing["upper_m"], thing["lower_m"])
    np.testing.assert_allclose(thing["extent_m"], extent_m, atol=1.1e-3)
    query_command(run, texts, voxel_m=VOXEL_M, top_k=1, as_json=True)
    assert capsys.readouterr().out == printed
    query_command(run, texts, voxel_m=VOXEL_M, top_k=1)
    table = capsys.readouterr().out
    assert f"{thing['score']:.2f}" in table
    assert "toilet: nothing found; the best relevance of an object is 0." in table
    assert (thing["label"], thing["views"]) == ("bed", answer_of(run, "bed").things[0].views)
    with pytest.raises(ProgroundError, match="go together"):
        query_command(run, texts, image=run / "thing.png")


def test_the_recording_has_a_mesh_and_boxes_for_each_query(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "answers.rrd"
    query_command(run, ("bed", "toilet"), voxel_m=VOXEL_M, rrd=path)
    assert str(path) in capsys.readouterr().out
    _, (bed, toilet) = query_run(run, ["bed", "toilet"], VOXEL_M, 5)
    rows = rows_of(path)
    things = bed.things
    labels = rows["/world/found/0", "Boxes3D:labels"][0][1]
    assert labels == [f"bed {thing.score:.2f}" for thing in things]
    centers = rows["/world/found/0", "Boxes3D:centers"][0][1]
    expected = [(thing.lower_m + thing.upper_m) / 2 for thing in things]
    np.testing.assert_allclose(centers, expected, atol=1e-5)
    colors = [
        np.array(rows[f"/world/map/relevance/{number}", "Mesh3D:vertex_colors"][0][1])
        for number in range(2)
    ]
    differ = colors[0] != colors[1]
    warm = (bed.scores > bed.measure.threshold) & (toilet.scores == 0)
    assert differ[warm].all()
    assert warm[things[0].vertices].mean() > 0.5
    assert not differ[(bed.scores == 0) & (toilet.scores == 0)].any()
    with pytest.raises(ProgroundError, match="--overwrite"):
        query_command(run, ("bed",), rrd=path)


def test_colours_negatives_and_relations_only_take_things_away(run: Path) -> None:
    (sofa,) = [thing for thing in RoomSource(frames=1).objects if thing.class_name == "sofa"]
    color = sofa.color_name
    other = next(name for name in ("green", "purple") if name != color)
    names = [
        *("sofa", f"{color} sofa", f"{other} sofa", "sofa, not bed", "sofa, not couch"),
        *("sofa near table", "sofa near bed", "sofa on bed"),
    ]
    surface, answers = query_run(run, names, VOXEL_M, 99)
    plain, colored, miscolored, negative, nothing, near, far, on = answers
    best = max(plain.things, key=size)

    def has_best(answer: Answer) -> bool:
        return any(thing.box is best.box for thing in answer.things)

    assert has_best(colored)
    assert not has_best(miscolored)
    assert has_best(near)
    assert not has_best(on)
    assert len(far.things) <= len(plain.things)
    np.testing.assert_array_equal(colored.scores, plain.scores)
    # A negative keeps just the vertices that it fits less by the margin.
    semantics = neural_map(run).semantics_at(surface.mesh.vertices_m)
    heads = surface.description.heads
    texts = BuiltinTexts().embed(["sofa", "bed", "couch"])
    logits = vertex_logits(semantics.embeddings, semantics.scale_logits, heads, texts)
    for answer, column in ((negative, 1), (nothing, 2)):
        lead = logits[:, 0] - logits[:, column]
        sure = np.abs(lead - NOT_MARGIN) > 1e-3
        expected = np.where(lead >= NOT_MARGIN, plain.scores, 0)
        np.testing.assert_allclose(answer.scores[sure], expected[sure], atol=1e-5)
        assert 0 < (answer.scores > 0).sum() < (plain.scores > 0).sum()


def test_a_query_for_what_is_irrelevant_to_the_task_says_so(run: Path) -> None:
    answer = answer_of(run, "rug")
    assert answer.things == ()
    assert answer.notes == ("'rug' is irrelevant to the task: no object is of it",)


def test_what_is_asked_is_understood_before_the_surface_is_extracted(
    run: Path, encoder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "proground_log.query.surface.extract_mesh", lambda *_: pytest.fail("began to work")
    )
    (tmp_path / "no.png").write_bytes(b"no picture")
    with pytest.raises(ProgroundError, match="cannot be read as an image"):
        query_run(run, [], VOXEL_M, 5, image=ImageQuery(tmp_path / "no.png", encoder))
    with pytest.raises(ProgroundError, match="elephant"):
        query_run(run, ["elephant"], VOXEL_M, 5)
    with pytest.raises(ProgroundError, match="best 0"):
        query_run(run, ["sofa"], VOXEL_M, 0)


def test_a_query_outside_the_task_says_so(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, (sofa, couch) = query_run(run, ["sofa", "sofa, not couch"], VOXEL_M, 5)
    assert sofa.notes == ()
    (note,) = couch.notes
    assert note.startswith("'couch' is none of the task's prompts")
    query_command(run, ("couch",), voxel_m=VOXEL_M, as_json=True)
    (answer,) = json.loads(capsys.readouterr().out)
    assert answer["notes"] == [note]
    query_command(run, ("couch",), voxel_m=VOXEL_M)
    assert "couch: 'couch' is none of the task's prompts" in capsys.readouterr().out
    _, (lost,) = query_run(run, ["sofa on toilet"], VOXEL_M, 5)
    assert lost.things == ()
    assert any("'toilet'" in note and "to be on" in note for note in lost.notes)
