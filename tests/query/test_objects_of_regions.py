"""Objects of a level sheet that frames saw, region by region: what is one thing and what is two."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from proground_log.mapping.objects import SceneObject
from proground_log.query.objects import LEAST_RELEVANCE, object_of_vertices
from proground_log.query.objects_of_regions import objects_of_regions
from proground_log.query.sightings import LEAST_AREA_M2
from proground_log.streams import stream
from tests.query.sheets import UP, Look, patch, sheet, sightings_of

VOXEL_M = 0.04
SHAPE = (40, 30)
MESH = sheet(*SHAPE, VOXEL_M)
PROMPTS = ("table", "cup")
TABLE, CUP, OTHER = np.eye(3) * 0.7 + 0.1
"""Relevance to table, to cup, and to a text that no object is of."""
ALL = np.ones(SHAPE, bool).ravel()
NONE = ~ALL


def area(rows: slice, columns: slice = slice(5, 15)) -> np.ndarray:
    return patch(rows, columns, SHAPE)


def objects_of(
    looks: Sequence[Look], relevance: np.ndarray | Sequence[np.ndarray]
) -> list[SceneObject]:
    """The objects; relevance is that of all regions, or of each."""
    sightings = sightings_of(looks, len(ALL))
    rows = np.broadcast_to(np.asarray(relevance), (len(sightings), 3))
    return objects_of_regions(MESH, sightings, rows, PROMPTS, UP, VOXEL_M)


def vertices_of(objects: Sequence[SceneObject]) -> list[list[int]]:
    return [thing.vertices.tolist() for thing in objects]


def numbers(mask: np.ndarray) -> list[int]:
    return np.flatnonzero(mask).tolist()


def test_two_cups_that_touch_are_two() -> None:
    left, right = area(slice(10, 14), slice(5, 9)), area(slice(10, 14), slice(9, 13))
    objects = objects_of([(ALL, [left, right])] * 10, CUP)
    assert [thing.label for thing in objects] == ["cup", "cup"]
    assert vertices_of(objects) == [numbers(left), numbers(right)]
    np.testing.assert_array_equal(
        object_of_vertices(objects, len(ALL)), np.where(left, 0, np.where(right, 1, -1))
    )


def test_what_two_things_claim_as_often_is_of_the_first() -> None:
    upper, between, lower = (area(rows) for rows in (slice(0, 8), slice(8, 10), slice(10, 18)))
    looks = [(ALL, [upper | between, lower]), (ALL, [upper, between | lower])] * 5
    assert vertices_of(objects_of(looks, CUP)) == [numbers(upper | between), numbers(lower)]
    swapped = [(seen, masks[::-1]) for seen, masks in looks]
    assert vertices_of(objects_of(swapped, CUP)) == [numbers(between | lower), numbers(upper)]


def test_an_object_says_where_it_is_how_sure_and_who_saw_it() -> None:
    thing = area(slice(10, 20))
    # Two frames find nothing, and one sees the thing as two.
    halves = [area(slice(10, 15)), area(slice(15, 20))]
    looks = [(ALL, [thing])] * 3 + [(ALL, [])] * 2 + [(ALL, halves)] + [(ALL, [thing])] * 4
    chairs = [0.4 + 0.05 * number for number in range(9)]
    (found,) = objects_of(looks, [np.array([chance, 0.2, 0.0]) for chance in chairs])
    assert (found.label, found.views) == ("table", 8)
    np.testing.assert_array_equal(found.witnesses, np.arange(9))
    assert found.score == pytest.approx(np.mean(chairs))
    assert vertices_of([found]) == [numbers(thing)]
    middle_m = MESH.vertices_m[thing].mean(axis=0)
    np.testing.assert_allclose(found.position_m, middle_m, atol=1e-6)
    np.testing.assert_allclose(found.box.centre_m, middle_m, atol=1e-6)


HID = slice(22, 26)
"""Rows that an occluder hides from the frames before it; eight rows of chair lie beyond."""


@pytest.mark.parametrize(("across", "things"), [(3, 1), (0, 2)])
def test_what_an_occluder_cuts_is_joined_by_frames_that_see_across(
    across: int, things: int
) -> None:
    whole, large, small = area(slice(0, 28)), area(slice(0, 22)), area(slice(26, 28))
    looks = [(~area(HID, slice(0, 30)), [large, small])] * 10 + [(ALL, [whole])] * across
    objects = objects_of(looks, TABLE)
    assert len(objects) == things
    if across:
        assert vertices_of(objects) == [numbers(whole)]
    else:
        assert sorted(vertices_of(objects)) == [numbers(large), numbers(small)]


@pytest.mark.parametrize(("as_one", "things"), [(0, 2), (1, 2), (2, 1)])
def test_most_of_the_frames_that_see_across_decide(as_one: int, things: int) -> None:
    whole, large, small = area(slice(0, 28)), area(slice(0, 24)), area(slice(24, 28))
    hidden = (~area(HID, slice(0, 30)), [area(slice(0, 22)), area(slice(26, 28))])
    across = [(ALL, [whole])] * as_one + [(ALL, [large, small])] * (3 - as_one)
    objects = objects_of([hidden] * 10 + across, TABLE)
    parts = [whole] if things == 1 else [large, small]
    assert vertices_of(objects) == [numbers(part) for part in parts]


def test_pieces_of_another_label_or_as_large_are_things_of_their_own() -> None:
    """Three frames take for one what ten, which do not see the middle, take for two."""
    unseen = ~area(HID, slice(0, 30))
    small = area(slice(26, 28))
    looks = [(unseen, [area(slice(0, 22)), small])] * 10 + [(ALL, [area(slice(0, 28))])] * 3
    objects = objects_of(looks, [TABLE, CUP] * 10 + [TABLE] * 3)
    assert [thing.label for thing in objects] == ["table", "cup"]
    assert vertices_of(objects)[1] == numbers(small)
    alike = area(slice(26, 40))
    looks = [(unseen, [area(slice(0, 22)), alike])] * 10 + [(ALL, [area(slice(0, 40))])] * 3
    objects = objects_of(looks, TABLE)
    assert len(objects) == 2
    assert numbers(alike) in vertices_of(objects)


def test_what_fits_no_prompt_is_no_object() -> None:
    wall, thing = area(slice(0, 10)), area(slice(20, 30))
    looks = [(ALL, [wall, thing])] * 10
    for faint, count in ((0.9, 1), (1.1, 2)):
        chances = [CUP * faint * LEAST_RELEVANCE / CUP.max(), TABLE] * 10
        objects = objects_of(looks, chances)
        assert [thing.label for thing in objects] == ["table", "cup"][:count]
        assert vertices_of(objects)[0] == numbers(thing)
    assert objects_of(looks, OTHER) == []


def test_a_label_is_what_all_frames_say_together() -> None:
    """Three of ten take it for a cup, and are surer."""
    thing = area(slice(20, 30))
    looks = [(ALL, [thing])] * 10
    (found,) = objects_of(looks, [np.array([0.5, 0.3, 0])] * 7 + [np.array([0.2, 0.6, 0])] * 3)
    assert (found.label, found.score) == ("table", pytest.approx(0.41))


@pytest.mark.parametrize(
    ("frames", "views", "found"),
    [
        *((10, 1, True), (20, 1, False), (20, 2, True), (60, 3, False), (60, 4, True)),
        *((200, 4, False), (200, 5, True)),
    ],
)
def test_what_too_few_frames_show_is_an_accident(frames: int, views: int, found: bool) -> None:
    """A view in each 20 frames and one, but no more than five."""
    thing = area(slice(20, 30))
    looks = [(thing, [thing])] * views + [(~thing, [])] * (frames - views)
    assert len(objects_of(looks, CUP)) == found


def test_what_frames_see_and_do_not_find_is_not_there() -> None:
    """0.15 of the frames that see a vertex have to find something on it."""
    thing = area(slice(20, 30))
    for missed, count in ((11, 1), (12, 0)):
        looks = [(ALL, [thing])] * 2 + [(ALL, [])] * missed
        assert len(objects_of(looks, CUP)) == count


def test_the_rim_that_masks_bleed_onto_is_cut_off() -> None:
    core, bled = area(slice(10, 20)), area(slice(10, 21))
    for bleeding, kept in ((3, core), (5, bled)):
        looks = [(ALL, [bled])] * bleeding + [(ALL, [core])] * (10 - bleeding)
        assert vertices_of(objects_of(looks, CUP)) == [numbers(kept)]


def test_strays_are_cut_off_and_large_parts_stay() -> None:
    core = area(slice(0, 10))
    for rows, stays in ((1, False), (3, True)):
        part = area(slice(30, 30 + rows))
        (found,) = objects_of([(ALL, [core | part])] * 10, CUP)
        assert vertices_of([found]) == [numbers(core | part if stays else core)]
    # A crack of two voxels does not make a stray.
    near = area(slice(12, 13))
    assert vertices_of(objects_of([(ALL, [core | near])] * 10, CUP)) == [numbers(core | near)]


def test_specks_are_no_objects() -> None:
    least = int(np.ceil(LEAST_AREA_M2 / VOXEL_M**2))
    for count in (least - 1, least):
        speck = area(slice(3, 4), slice(5, 5 + count))
        assert len(objects_of([(ALL, [speck])] * 10, CUP)) == (count == least)


def test_objects_come_by_prompt_then_score_then_first_region() -> None:
    places = [area(slice(6 * n, 6 * n + 5)) for n in range(5)]
    chances = [0.8 * CUP, 0.5 * TABLE, CUP, 0.8 * CUP, TABLE]
    looks = [(ALL, places)] * 6
    objects = objects_of(looks, chances * 6)
    assert [thing.label for thing in objects] == ["table"] * 2 + ["cup"] * 3
    assert vertices_of(objects) == [numbers(places[n]) for n in (4, 1, 2, 0, 3)]


@pytest.mark.parametrize("looks", [[], [(ALL, [])], [(NONE, [])] * 30])
def test_where_nothing_was_found_there_are_no_objects(looks: list[Look]) -> None:
    assert objects_of(looks, CUP) == []


def test_the_order_of_regions_within_a_frame_changes_nothing() -> None:
    """Noisy masks of six things, so that no two weights are alike."""
    draw = stream(8, "noise")
    places = [area(slice(6 * n, 6 * n + 6), slice(3, 25 - n)) for n in range(6)]
    looks: list[Look] = []
    shuffled: list[Look] = []
    chances, shuffled_chances = [], []
    for _ in range(15):
        seen = draw.random(len(ALL)) < 0.9
        order = draw.permutation(6)
        masks = [place & seen & (draw.random(len(ALL)) < draw.uniform(0.5, 1)) for place in places]
        relevance = draw.uniform(0.1, 0.2, (6, 3))
        relevance[np.arange(6), [0, 1, 1, 0, 1, 0]] += 0.5
        looks.append((seen, masks))
        shuffled.append((seen, [masks[n] for n in order]))
        chances += [*relevance]
        shuffled_chances += [*relevance[order]]
    objects, others = objects_of(looks, chances), objects_of(shuffled, shuffled_chances)
    assert len(objects) == 6
    assert vertices_of(objects) == vertices_of(others)
    for thing, other in zip(objects, others, strict=True):
        assert (thing.label, thing.views) == (other.label, other.views)
        assert thing.score == pytest.approx(other.score, abs=1e-12)
