"""What frames see of a surface: a camera over a floor with a box on it, whose views are exact."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from proground_log.camera import Camera, transform
from proground_log.frame import AT_EDGE, NO_REGION, Frame
from proground_log.perception.heads import TextHeads
from proground_log.query.mesh import Mesh
from proground_log.query.objects_of_regions import objects_of_regions
from proground_log.query.sightings import (
    LEAST_AREA_M2,
    LEAST_CONFIDENCE,
    NEAREST_M,
    TOLERANCE_M,
    Sightings,
    find_sightings,
)
from proground_log.regions import EMBEDDING_WIDTH, LEVELS, Regions
from proground_log.streams import stream
from tests.query.sheets import UP, sheet

VOXEL_M = 0.05
HEIGHT_M, TOP_M, HALF_M = 2.0, 0.5, 0.3
"""Of the camera over the floor, of the box's top over it, and half the top's side."""
CAMERA = Camera(120, 90, 100.0, 100.0, 60.0, 45.0)
"""It sees 1.2 m of the floor to either side, and 0.9 m."""
TURN = np.eye(4)
TURN[:3, :3] = Rotation.from_euler("xyz", (20, -35, 50), degrees=True).as_matrix()
TURN[:3, 3] = 3.0, -1.0, 0.7
"""How the scene lies in the world."""
DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, HEIGHT_M], [0, 0, 0, 1]])
"""Pose of the camera in the scene: it looks down, its top to y."""

AXIS_M = np.arange(-1.475, 1.5, VOXEL_M)
"""None of the points lies within a pixel of a border."""
FLOOR = np.stack(np.meshgrid(AXIS_M, AXIS_M, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
TOP = FLOOR[np.abs(FLOOR[:, :2]).max(axis=1) < HALF_M] + (0, 0, TOP_M)
SCENE_M = np.concatenate([FLOOR, TOP])
IS_TOP = np.arange(len(SCENE_M)) >= len(FLOOR)

IN_VIEW = (np.abs(SCENE_M[:, 0]) < 1.2) & (np.abs(SCENE_M[:, 1]) < 0.9)
SHADOW_M = HALF_M * HEIGHT_M / (HEIGHT_M - TOP_M)
HIDDEN = np.abs(SCENE_M[:, :2]).max(axis=1) < SHADOW_M
SEEN = IS_TOP | (IN_VIEW & ~HIDDEN)


def world(points_m: np.ndarray) -> np.ndarray:
    """Points of the scene in the world, as a mesh has them."""
    return transform(TURN, points_m).astype(np.float32)


def on_top() -> np.ndarray:
    """The pixels that show the box, bool [H, W]."""
    row, column = np.mgrid[:90, :120]
    nearer = HALF_M * CAMERA.fx / (HEIGHT_M - TOP_M)
    return (np.abs(column + 0.5 - 60) < nearer) & (np.abs(row + 0.5 - 45) < nearer)


def regions(count: int) -> Regions:
    """So many sure regions; where they are, frames say."""
    draw = stream(3, "regions")
    relevance = np.full((count, 2), 0.01, np.float32)
    relevance[:, 0] = 0.9
    return Regions(
        boxes=np.zeros((count, 4), np.float32),
        levels=(np.arange(count) % LEVELS).astype(np.uint8),
        relevance=relevance,
        embeddings=draw.normal(size=(count, EMBEDDING_WIDTH)).astype(np.float16),
        owner=np.zeros((90, 120), np.uint16),
        is_box=np.zeros(count, bool),
    )


def frame(region_of: np.ndarray | None, found: Regions | None) -> Frame:
    depth_m = np.where(on_top(), HEIGHT_M - TOP_M, HEIGHT_M).astype(np.float32)
    color = np.zeros((90, 120, 3), np.uint8)
    return Frame(
        *(0, 0, CAMERA, TURN @ DOWN, depth_m, color, np.ones((90, 120), bool), None),
        regions=found,
        region_of=None if region_of is None else region_of.astype(np.int32),
    )


def two_regions() -> np.ndarray:
    """0 on the box, 1 on the left third of the picture."""
    image = np.where(on_top(), 0, NO_REGION)
    image[:, :40] = 1
    return image


LEFT = SEEN & (SCENE_M[:, 0] < -0.4)
"""The vertices of the left third: 40 of 120 pixels, up to 20 pixels off the middle."""


def sets(sightings: Sightings) -> tuple[list[set[int]], list[set[int]]]:
    """The vertices of each region and those of each frame, by number."""
    both = []
    for matrix in (sightings.regions, sightings.seen):
        assert matrix.has_sorted_indices
        assert set(matrix.data.tolist()) <= {1.0}
        columns = matrix.tocsc()
        both.append(
            [set(part.tolist()) for part in np.split(columns.indices, columns.indptr[1:-1])]
            if matrix.shape[1]
            else []
        )
    return both[0], both[1]


def numbers(chosen: np.ndarray) -> set[int]:
    return set(np.flatnonzero(chosen).tolist())


def test_a_frame_sees_what_nothing_hides_and_knows_the_regions_on_it() -> None:
    found = regions(2)
    sightings = find_sightings(world(SCENE_M), [frame(two_regions(), found)], VOXEL_M)
    on_regions, seen = sets(sightings)
    assert seen == [numbers(SEEN)]
    assert on_regions == [numbers(IS_TOP), numbers(LEFT)]
    assert 100 < len(on_regions[0]) < len(on_regions[1]) < len(seen[0]) < len(SCENE_M)
    np.testing.assert_array_equal(sightings.embeddings, found.embeddings.astype(np.float32))
    np.testing.assert_array_equal(sightings.levels, found.levels)


def test_regions_are_numbered_over_the_frames_that_have_some() -> None:
    image, nothing = two_regions(), np.full((90, 120), NO_REGION)
    frames = [
        frame(image, regions(2)),
        frame(None, None),
        frame(nothing, regions(0)),
        frame(np.where(image == 0, NO_REGION, image), regions(2)),
    ]
    sightings = find_sightings(world(SCENE_M), frames, VOXEL_M)
    on_regions, seen = sets(sightings)
    assert seen == [numbers(SEEN)] * 3
    assert on_regions == [numbers(IS_TOP), numbers(LEFT), numbers(LEFT)]
    np.testing.assert_array_equal(sightings.frame_of, [0, 0, 2])
    np.testing.assert_array_equal(sightings.levels, [0, 1, 1])
    np.testing.assert_array_equal(
        sightings.embeddings, regions(2).embeddings[[0, 1, 1]].astype(np.float32)
    )


@pytest.mark.parametrize("frames", [[], [frame(None, None)]])
def test_without_regions_there_are_no_sightings(frames: list[Frame]) -> None:
    sightings = find_sightings(world(SCENE_M), frames, VOXEL_M)
    assert len(sightings) == 0
    assert sightings.regions.shape == sightings.seen.shape == (len(SCENE_M), 0)
    assert sightings.embeddings.shape == (0, EMBEDDING_WIDTH)


def test_what_lies_beside_a_jump_of_depth_is_not_seen() -> None:
    image = two_regions()
    image[:, 58:62] = AT_EDGE
    sightings = find_sightings(world(SCENE_M), [frame(image, regions(2))], VOXEL_M)
    (top, left), (seen,) = sets(sightings)
    # Four columns are 6 cm of the top to either side of its middle, rounded to whole pixels.
    depth_m = np.where(IS_TOP, HEIGHT_M - TOP_M, HEIGHT_M)
    column = np.floor(60 + 100 * SCENE_M[:, 0] / depth_m)
    at_edge = (column >= 58) & (column < 62)
    assert 0 < np.count_nonzero(at_edge & IS_TOP) < IS_TOP.sum()
    assert seen == numbers(SEEN & ~at_edge)
    assert top == numbers(IS_TOP & ~at_edge)
    assert left == numbers(LEFT)


def test_boxes_doubtful_and_tiny_regions_are_left_out_but_seen() -> None:
    image = two_regions()
    # As many vertices as make the least area, and one fewer.
    least = int(np.ceil(LEAST_AREA_M2 / VOXEL_M**2))
    right = np.flatnonzero(SEEN & (SCENE_M[:, 0] > 0.5))
    rows_columns = np.floor([[45, 60]] + 100 * SCENE_M[right][:, [1, 0]] * (-1, 1) / HEIGHT_M)
    enough, few = rows_columns[:least].astype(int), rows_columns[-(least - 1) :].astype(int)
    image[tuple(enough.T)], image[tuple(few.T)] = 2, 3
    everything = find_sightings(world(SCENE_M), [frame(image, regions(4))], VOXEL_M)
    on_regions, seen = sets(everything)
    assert on_regions == [numbers(IS_TOP), numbers(LEFT), set(right[:least].tolist())]
    assert seen == [numbers(SEEN)]
    np.testing.assert_array_equal(everything.levels, [0, 1, 2])

    boxed = replace(regions(4), is_box=np.array([True, False, False, False]))
    on_regions, seen = sets(find_sightings(world(SCENE_M), [frame(image, boxed)], VOXEL_M))
    assert on_regions == [numbers(LEFT), set(right[:least].tolist())]
    assert seen == [numbers(SEEN)]

    doubtful = regions(4)
    doubtful.relevance[1, 0] = LEAST_CONFIDENCE - 1e-3
    on_regions, _ = sets(find_sightings(world(SCENE_M), [frame(image, doubtful)], VOXEL_M))
    assert on_regions == [numbers(IS_TOP), set(right[:least].tolist())]


def test_only_what_lies_at_the_measured_depth_before_the_camera_is_seen() -> None:
    offsets_m = np.array([0, 0.9, -0.9, 1.1, -1.1]) * TOLERANCE_M
    points_m = np.stack([np.full(5, 0.7), np.full(5, 0.6), offsets_m], axis=1)
    behind_m = np.array([[0.0, 0.0, 2 * HEIGHT_M - TOP_M]])
    image = frame(two_regions(), regions(2))
    _, (seen,) = sets(find_sightings(world(np.concatenate([points_m, behind_m])), [image], VOXEL_M))
    assert seen == {0, 1, 2}
    image.depth_m[:] = 0
    _, (seen,) = sets(find_sightings(world(points_m), [image], VOXEL_M))
    assert seen == set()
    # Just within and just without the picture.
    image.depth_m[:] = HEIGHT_M
    ends_m = np.array([[1.199, 0, 0], [0, 0.899, 0], [1.201, 0, 0], [0, 0.901, 0]])
    _, (seen,) = sets(find_sightings(world(np.concatenate([ends_m, -ends_m])), [image], VOXEL_M))
    assert seen == {0, 1, 4, 5}
    # Nothing is looked for that touches the lens.
    for away_m, count in ((0.9 * NEAREST_M, 0), (1.1 * NEAREST_M, 1)):
        image.depth_m[:] = away_m
        at_lens = world(np.array([[0.0, 0.0, HEIGHT_M - away_m]]))
        _, (seen,) = sets(find_sightings(at_lens, [image], VOXEL_M))
        assert len(seen) == count


def test_each_region_is_read_by_the_head_of_its_level() -> None:
    draw = stream(4, "heads")
    heads = TextHeads(
        *draw.normal(size=(2, LEVELS, EMBEDDING_WIDTH)).astype(np.float32),
        *draw.uniform(1, 2, (2, LEVELS)).astype(np.float32),
    )
    texts = draw.normal(size=(5, EMBEDDING_WIDTH)).astype(np.float32)
    texts /= np.linalg.norm(texts, axis=1, keepdims=True)
    image = np.arange(120 * 90).reshape(90, 120) * 6 // (120 * 90)
    sightings = find_sightings(world(SCENE_M), [frame(image, regions(6))], VOXEL_M)
    assert sightings.levels.tolist() == [0, 1, 2, 0, 1, 2]
    logits = sightings.logits(heads, texts)
    assert (logits.shape, logits.dtype) == ((6, 5), np.float32)
    for region, level in enumerate(sightings.levels):
        alone = heads.logits(sightings.embeddings[[region]], int(level), texts)
        np.testing.assert_allclose(logits[[region]], alone, atol=1e-4)


def test_with_too_many_regions_every_so_many_th_frame_stays() -> None:
    image = np.arange(120 * 90).reshape(90, 120) * 6 // (120 * 90)
    views = [frame(image, regions(6)) for _ in range(7)]
    vertices_m = world(SCENE_M)
    whole = find_sightings(vertices_m, views, VOXEL_M)
    assert len(whole) == 42
    for most, stride in ((42, 1), (41, 2), (24, 2), (23, 3), (18, 3), (17, 4), (6, 7), (1, 7)):
        thin, chosen = whole.thinned(most), find_sightings(vertices_m, views[::stride], VOXEL_M)
        np.testing.assert_array_equal(thin.frame_of, chosen.frame_of)
        assert (thin.regions != chosen.regions).nnz == (thin.seen != chosen.seen).nnz == 0
        np.testing.assert_array_equal(thin.embeddings, chosen.embeddings)
        np.testing.assert_array_equal(thin.levels, chosen.levels)
    assert len(find_sightings(vertices_m, [], VOXEL_M).thinned(3)) == 0


def digest_of_objects() -> str:
    """Of the objects of a wavy sheet that many frames see from all around."""
    draw = stream(5, "sheet")
    flat = sheet(60, 60, VOXEL_M)
    vertices_m = flat.vertices_m - np.array([1.5, 1.5, 0])
    mesh = Mesh(vertices_m.astype(np.float32), flat.faces, flat.normals, flat.colors)
    frames = []
    for number in range(12):
        pose = DOWN.copy()
        pose[:2, 3] = draw.uniform(-0.3, 0.3, 2)
        row, column = np.mgrid[:90, :120]
        tiles = (row + 3 * number) // 30 * 5 + (column + 5 * number) // 40
        found = regions(int(tiles.max()) + 1)
        flat_depth = np.full((90, 120), HEIGHT_M, np.float32)
        seen = frame(tiles, found)
        frames.append(replace(seen, world_from_camera=pose, depth_m=flat_depth))
    sightings = find_sightings(mesh.vertices_m, frames, VOXEL_M)
    relevance = draw.uniform(0.1, 1, (len(sightings), 3))
    objects = objects_of_regions(mesh, sightings, relevance, ("a", "b"), UP, VOXEL_M)
    assert objects
    digest = hashlib.sha256(sightings.seen.indices.tobytes())
    for thing in objects:
        parts = thing.vertices, thing.position_m, thing.box.corners_m
        digest.update(b"".join(part.tobytes() for part in parts))
        digest.update(f"{thing.label} {thing.score!r} {thing.views}".encode())
    return digest.hexdigest()


@pytest.mark.slow
def test_objects_do_not_depend_on_the_number_of_threads() -> None:
    program = (
        "import sys, torch; from tests.query.test_sightings import digest_of_objects\n"
        "torch.set_num_threads(int(sys.argv[1])); print(digest_of_objects())"
    )
    variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    threads = "2" if os.environ.get("OMP_NUM_THREADS") == "1" else "1"
    there = subprocess.run(
        [sys.executable, "-c", program, threads],
        env={**os.environ, **dict.fromkeys(variables, threads)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert there.strip() == digest_of_objects()
