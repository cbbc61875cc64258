"""What a replay with a task tells of meaning stands in the recording, value by value."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from proground_log.events import MeshExtracted, SemanticView, SurfaceMeaning, TaskKnown
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from proground_log.telemetry.surface import heat_colors
from tests.telemetry import telemetry_stream as stream
from tests.telemetry.telemetry_cells import Rows, rows_of, scalars

FRAMES = range(6)
TASK = stream.TASK
MEMORIES = [stream.statistics(index, TASK) for index in FRAMES]
BACKGROUND_COLOR = (84, 87, 94)


def record(path: Path, frames: range, task: TaskKnown) -> Path:
    sink = TelemetrySink(path, recording_id="run")
    for event in stream.of_frames(frames, task):
        sink.on_event(event)
    sink.close()
    merge_segments([path], path)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("run") / "telemetry.rrd", FRAMES, TASK)


@pytest.fixture(scope="module")
def rows(recording: Path) -> Rows:
    return rows_of(recording)


def curves(rows: Rows, entity: str) -> list[list[float]]:
    """Rows of an entity that is several curves."""
    return [value for _, value in rows[entity, "Scalars:scalars"]]


def classes(rows: Rows, entity: str) -> dict[int, tuple[str, tuple[int, int, int]]]:
    """Name and colour by class, of the annotations that an entity carries."""
    [(times, [context])] = rows[entity, "AnnotationContext:context"]
    assert times == ()
    infos = [entry["class_description"]["info"] for entry in context]
    return {info["id"]: (info["label"], rgb(info["color"])) for info in infos}


def rgb(color: int) -> tuple[int, int, int]:
    """Red, green and blue of a colour in rerun's packing."""
    return color >> 24, color >> 16 & 255, color >> 8 & 255


def view(index: int) -> SemanticView:
    """The semantic part of a frame's view."""
    found = stream.view(index, TASK).semantics
    assert found is not None
    return found


def mesh(index: int) -> tuple[MeshExtracted, SurfaceMeaning]:
    """A frame's mesh, and its meaning."""
    found = stream.mesh(index, TASK)
    assert found.meaning is not None
    return found, found.meaning


def pixels(rows: Rows, entity: str, archetype: str, dtype: Any) -> list[np.ndarray]:
    """The raw images of an entity, [24, 32] each."""
    buffers = [value[0] for _, value in rows[entity, f"{archetype}:buffer"]]
    return [np.array(b, dtype=np.uint8).view(dtype).reshape(24, 32) for b in buffers]


def test_labels_have_the_names_and_colours_of_the_task(rows: Rows) -> None:
    expected = {0: ("background", BACKGROUND_COLOR)}
    for number, prompt in enumerate(TASK.prompts):
        expected[number + 1] = (prompt, tuple(TASK.colors[number].tolist()))
    assert classes(rows, "/view/input/labels") == expected
    assert classes(rows, "/view/rendered/labels") == expected
    names = [name for name, _ in classes(rows, "/view/rendered/scale").values()]
    assert names == ["P3", "P4", "P5", "no supervision"]


def test_the_task_is_a_table(rows: Rows) -> None:
    [(times, [text])] = rows["/task", "TextDocument:text"]
    assert times == ()
    assert "# Task: breakfast" in text
    assert "| 1 | a red chair | `#e63c32` |" in text
    assert r"| 2 | salt/pepper \| mill | `#3cc85a` |" in text


def test_every_loss_of_meaning_is_there_bit_for_bit(rows: Rows) -> None:
    steps = len(FRAMES) * stream.STEPS_PER_FRAME
    given = [stream.losses(step, TASK) for step in range(steps)]
    for name in given[1]:
        times, values = scalars(rows, f"/loss/{name}")
        assert values.tolist() == [losses[name] for losses in given if name in losses]
        assert times[-1, 1] == steps - 1
    assert len(scalars(rows, "/loss/semantic")[1]) == steps - 1


def test_curves_keep_their_colours_whichever_term_comes_first(tmp_path: Path, rows: Rows) -> None:
    # The first step of this segment has a term that the whole recording's lacks.
    later = rows_of(record(tmp_path / "later.rrd", range(3, 6), TASK))
    names = "semantic", "scale", "uncertainty"
    colors = [rows[f"/loss/{name}", "SeriesLines:colors"] for name in names]
    assert colors == [later[f"/loss/{name}", "SeriesLines:colors"] for name in names]
    assert len({str(color) for color in colors}) == len(names)


def test_scores_are_drawn_where_there_are_any(rows: Rows) -> None:
    for name in ("label", "scale", "background", "uncertainty"):
        given = [(index, getattr(stream.scores(index), name)) for index in FRAMES]
        known = [(index, score) for index, score in given if not math.isnan(score)]
        times, values = scalars(rows, f"/heads/{name}")
        assert list(zip(times[:, 0].tolist(), values.tolist(), strict=True)) == known
    assert len(scalars(rows, "/heads/background")[1]) == 3


def test_the_memory_of_meaning_is_drawn(rows: Rows) -> None:
    figures = {
        "samples": [memory.samples for memory in MEMORIES],
        "share": [memory.samples / memory.capacity for memory in MEMORIES],
        "background": [memory.background for memory in MEMORIES],
        "regions": [memory.regions for memory in MEMORIES],
        "size_bytes": [memory.size_bytes for memory in MEMORIES],
        "inserted": [memory.inserted for memory in MEMORIES],
        "evicted": [memory.evicted for memory in MEMORIES],
    }
    for name, expected in figures.items():
        times, values = scalars(rows, f"/semantics/{name}")
        assert values.tolist() == expected
        assert times[:, 0].tolist() == list(FRAMES)


def test_labels_and_levels_are_curves_by_name(rows: Rows) -> None:
    assert curves(rows, "/semantics/labels") == [
        list(memory.labels.values()) for memory in MEMORIES
    ]
    assert curves(rows, "/semantics/levels") == [memory.levels for memory in MEMORIES]
    [(_, names)] = rows["/semantics/labels", "SeriesLines:names"]
    assert names == list(TASK.prompts)
    [(_, colors)] = rows["/semantics/labels", "SeriesLines:colors"]
    assert [rgb(color) for color in colors] == [tuple(color) for color in TASK.colors.tolist()]


def test_of_many_labels_all_are_kept_and_the_first_are_visible(tmp_path: Path) -> None:
    prompts = tuple(f"thing {number}" for number in range(300))
    colors = np.random.default_rng(0).integers(0, 256, (300, 3), dtype=np.uint8)
    rows = rows_of(record(tmp_path / "many.rrd", range(2), TaskKnown("many", prompts, colors)))
    assert curves(rows, "/semantics/labels")[1] == list(range(1, 301))
    [(_, visible)] = rows["/semantics/labels", "SeriesLines:visible_series"]
    assert visible == [True] * 20 + [False] * 280


def test_views_of_labels_levels_and_uncertainty_keep_every_value(rows: Rows) -> None:
    labels = pixels(rows, "/view/rendered/labels", "SegmentationImage", np.uint16)
    observed = pixels(rows, "/view/input/labels", "SegmentationImage", np.uint16)
    levels = pixels(rows, "/view/rendered/scale", "SegmentationImage", np.uint8)
    uncertainty = pixels(rows, "/view/rendered/uncertainty", "DepthImage", np.float32)
    for index in FRAMES:
        given = view(index)
        np.testing.assert_array_equal(labels[index], given.labels + 1)
        np.testing.assert_array_equal(observed[index], given.observed_labels + 1)
        np.testing.assert_array_equal(levels[index], given.levels)
        np.testing.assert_array_equal(uncertainty[index], given.uncertainty)
    assert (labels[0] == 0).any()


def test_the_colours_of_embeddings_are_not_lossy(rows: Rows) -> None:
    for index, (_, blob) in enumerate(rows["/view/rendered/semantics", "EncodedImage:blob"]):
        bgr = cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(bgr[..., ::-1], view(index).features)


def test_the_surface_has_labels_embeddings_and_relevance(rows: Rows) -> None:
    relevance = "/world/map/relevance/salt\\/pepper\\ \\|\\ mill"
    palette = np.concatenate([TASK.colors, [BACKGROUND_COLOR]])  # -1 is the last.
    for index in FRAMES:
        given, meaning = mesh(index)
        expected = {
            "/world/map/semantics": palette[meaning.labels],
            "/world/map/features": meaning.features,
            relevance: heat_colors(meaning.relevance),
        }
        for entity, colors in expected.items():
            _, packed = rows[entity, "Mesh3D:vertex_colors"][index]
            np.testing.assert_array_equal([rgb(color) for color in packed], colors)
            _, vertices = rows[entity, "Mesh3D:vertex_positions"][index]
            np.testing.assert_array_equal(np.float32(vertices), given.vertices_m)
        assert (meaning.labels == -1).any()


def test_relevance_brightens_evenly() -> None:
    light = heat_colors(np.linspace(0, 1, 11, dtype=np.float32)) @ np.array([0.3, 0.59, 0.11])
    assert (np.diff(light) > 8).all()


def test_one_blueprint_comes_with_the_recording(recording: Path) -> None:
    assert len(RrdReader(recording).blueprints()) == 1


def test_without_a_task_nothing_of_meaning_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "plain.rrd"
    sink = TelemetrySink(path, recording_id="run")
    for event in stream.of_frames(range(2)):
        sink.on_event(event)
    sink.close()
    merge_segments([path], path)
    entities = {entity for entity, _ in rows_of(path)}
    maps = {entity for entity in entities if entity.startswith("/world/map")}
    assert maps == {"/world/map/color"}
    assert not any(entity.startswith(("/heads", "/task")) for entity in entities)
    assert not any("semantic" in entity or "label" in entity for entity in entities)
