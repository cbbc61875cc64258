"""The simulated detector: perfect without errors, and wrong as detectors are with them."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy import ndimage

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.perception.simulated.masks import find_things
from proground_log.perception.simulated.perceiver import (
    SimulatedPerception,
)
from proground_log.perception.task import Task
from proground_log.regions import Regions
from recorders.room import RoomSource
from recorders.room.scene import CLASSES, LABEL_NAMES, LABELS
from recorders.room.source import CAMERA
from tests.perception.simulated.label_counts import LabelCounts, count_labels

pytestmark = pytest.mark.slow

PROMPTS = tuple(c for c in CLASSES if c not in ("wall", "floor", "ceiling", "window", "door"))
TASK = Task("room", PROMPTS)


@pytest.fixture(scope="module")
def frames() -> list[SensorFrame]:
    room = RoomSource(frames=120)
    return [room.frame(index) for index in range(0, 120, 6)]


def detector(seed: int = 0, strength: float = 1.0, task: Task = TASK) -> SimulatedPerception:
    return SimulatedPerception(task, LABEL_NAMES, CAMERA, seed, strength)


def counts(
    perceive: SimulatedPerception, frames: list[SensorFrame], relevance: float = 0.05
) -> LabelCounts:
    total, prompts = LabelCounts(0, 0, 0), perceive.description.task.all_prompts
    for frame in frames:
        assert frame.labels is not None
        total += count_labels(perceive(frame), frame.labels, LABEL_NAMES, prompts, relevance)
    return total


def assert_equal(first: Regions, second: Regions) -> None:
    for field in fields(Regions):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


def painted(labels: np.ndarray, depth_m: float = 2.0) -> SensorFrame:
    depth = np.full(labels.shape, depth_m, np.float32)
    return SensorFrame(0, 0, 0, b"", "png", depth, np.eye(4), labels.astype(np.uint16))


def square(label: int, side: int) -> np.ndarray:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
    labels[100 : 100 + side, 150 : 150 + side] = label
    return labels


def test_without_errors_masks_boxes_and_classes_are_exact() -> None:
    labels = square(LABELS["sofa"], 60)
    labels[20:50, 30:80] = LABELS["cup"]
    regions = detector(strength=0)(painted(labels))
    assert {PROMPTS[label] for label in regions.labels} == {"sofa", "cup"}
    sofa, cup = (
        int(np.flatnonzero(regions.labels == PROMPTS.index(c))[0]) for c in ("sofa", "cup")
    )
    np.testing.assert_array_equal(regions.owner == sofa + 1, labels == LABELS["sofa"])
    np.testing.assert_array_equal(regions.owner == cup + 1, labels == LABELS["cup"])
    np.testing.assert_array_equal(regions.boxes[cup], (30, 20, 80, 50))
    assert regions.confidence.min() > 0.7
    assert not regions.is_box.any()


def test_a_frame_with_a_camera_of_its_own_is_seen_through_that() -> None:
    small = CAMERA.scaled_to_width(160)
    labels = np.zeros((small.height, small.width), np.uint16)
    labels[50:80, 75:105] = LABELS["sofa"]
    frame = replace(painted(labels), calibration=Calibration.registered(small))
    regions = detector(strength=0)(frame)
    np.testing.assert_array_equal(regions.boxes, [(75, 50, 105, 80)])
    # To a detector, which sees images of one width, it is the same picture.
    large = detector(strength=0)(painted(square(LABELS["sofa"], 60)))
    np.testing.assert_array_equal(regions.relevance, large.relevance)


def test_a_synonym_finds_its_class_and_the_unprompted_is_background() -> None:
    couch = detector(strength=0, task=Task("t", ("couch", "book")))
    regions = couch(painted(square(LABELS["sofa"], 60)))
    assert regions.labels.tolist() == [0]
    assert len(couch(painted(square(LABELS["refrigerator"], 60)))) == 0


def test_the_unprompted_passes_for_what_resembles_it_at_low_relevance() -> None:
    """No sofa is asked for, but a chair resembles one; with a sofa asked for, that wins."""
    frame = painted(square(LABELS["sofa"], 60))

    def best(*prompts: str) -> tuple[list[str], float]:
        """The best prompt of each seed that found any, and its mean relevance."""
        found = [detector(seed, task=Task("t", prompts))(frame) for seed in range(150)]
        best = [(prompts[f.labels[0]], float(f.confidence[0])) for f in found if len(f)]
        return [prompt for prompt, _ in best], float(np.mean([relevance for _, relevance in best]))

    without, low = best("chair", "book")
    with_it, high = best("chair", "sofa")
    assert 5 < len(without) < 40 < 100 < len(with_it)
    assert without.count("chair") > without.count("book")
    assert with_it.count("sofa") > 100
    assert low < 0.4 < high


@pytest.mark.parametrize("strength", [0.0, 1.0, 2.0])
def test_what_comes_out_keeps_the_contract_of_regions(
    frames: list[SensorFrame], strength: float
) -> None:
    perceive = detector(strength=strength)
    texts, heads = perceive.description.texts, perceive.description.heads
    levels = set()
    for frame in frames[::4]:
        regions = perceive(frame)
        levels |= set(regions.levels.tolist())
        assert regions.boxes.dtype == regions.relevance.dtype == np.float32
        assert regions.embeddings.dtype == np.float16
        assert regions.owner.dtype == np.uint16
        assert regions.owner.shape == (CAMERA.height, CAMERA.width)
        assert regions.owner.max() <= len(regions)
        assert (np.diff(regions.confidence) <= 0).all()
        assert regions.confidence.min() >= TASK.thresholds.detection
        x0, y0, x1, y1 = regions.boxes.T
        assert ((x0 >= 0) & (x0 < x1) & (x1 <= CAMERA.width)).all()
        assert ((y0 >= 0) & (y0 < y1) & (y1 <= CAMERA.height)).all()
        for number, box in enumerate(regions.boxes, start=1):
            rows, columns = np.nonzero(regions.owner == number)
            near = np.stack([columns, rows, columns + 1, rows + 1], axis=1) - box
            assert (near[:, :2] >= -0.51).all()
            assert (near[:, 2:] <= 0.51).all()
        for n, level in enumerate(regions.levels):
            logits = heads.logits(regions.embeddings[n : n + 1], int(level), texts)[0]
            np.testing.assert_allclose(regions.relevance[n], 1 / (1 + np.exp(-logits)), rtol=1e-5)
    assert levels == {0, 1, 2}


def test_the_wrong_levels_head_misreads_an_embedding(frames: list[SensorFrame]) -> None:
    perceive = detector(strength=0)
    regions, description = perceive(frames[0]), perceive.description
    wrong = [
        description.heads.logits(
            regions.embeddings[n : n + 1], (int(level) + 1) % 3, description.texts
        )
        for n, level in enumerate(regions.levels)
    ]
    relevance = 1 / (1 + np.exp(-np.concatenate(wrong)))
    assert np.abs(relevance - regions.relevance).max(axis=1).mean() > 0.2


def test_regions_depend_on_seed_and_frame_alone(frames: list[SensorFrame]) -> None:
    first, second, other = detector(), detector(), detector(seed=1)
    backward = [second(frame) for frame in reversed(frames[:3])][::-1]
    for frame, later in zip(frames[:3], backward, strict=True):
        assert_equal(first(frame), later)
    assert not np.array_equal(first(frames[0]).owner, other(frames[0]).owner)


def test_the_default_errors_leave_two_thirds_of_the_labels_right(
    frames: list[SensorFrame],
) -> None:
    found = [counts(detector(seed), frames) for seed in range(5)]
    sure = [counts(detector(seed), frames, 0.4) for seed in range(5)]
    accuracies = [each.accuracy for each in found]
    print(f"right on {np.round(accuracies, 3)} of the labelled pixels at 0.05")
    assert 0.6 < np.mean(accuracies) < 0.7
    assert 0.55 < min(accuracies) < max(accuracies) < 0.8
    for all_found, sure_found in zip(found, sure, strict=True):
        assert sure_found.precision > all_found.precision + 0.04


def test_accuracy_falls_with_strength_and_with_irrelevant_prompts(
    frames: list[SensorFrame],
) -> None:
    exact, mild, usual, strong = (counts(detector(0, s), frames) for s in (0, 0.5, 1, 1.5))
    assert exact.precision > 0.999
    assert exact.coverage > 0.99
    assert exact.accuracy > mild.accuracy > usual.accuracy > strong.accuracy
    irrelevant = ("car", "dog", "stool", "desk", "bowl", "wardrobe", "mirror", "laptop", "towel")
    crowded = replace(TASK, irrelevant=irrelevant)
    assert counts(detector(0, task=crowded), frames).accuracy < usual.accuracy


def test_relevance_falls_with_distance_size_truncation_and_occlusion() -> None:
    def relevance(frame: SensorFrame) -> float:
        """Mean over seeds, of the best region."""
        found = [detector(seed)(frame).confidence[:1].sum() for seed in range(40)]
        return float(np.mean(found))

    label = LABELS["chair"]
    plain = relevance(painted(square(label, 60)))
    assert relevance(painted(square(label, 60), depth_m=5.0)) < plain - 0.1
    assert relevance(painted(square(label, 8))) < plain - 0.1
    edge = np.roll(square(label, 60), (-100, -150), axis=(0, 1))
    assert relevance(painted(edge)) < plain - 0.05
    hidden = painted(square(label, 60))
    hidden.depth[hidden.labels == 0] = 1.0
    assert relevance(hidden) < plain - 0.1


def test_what_is_mistaken_is_mistaken_again_from_beside_but_not_from_elsewhere() -> None:
    frame = painted(square(LABELS["chair"], 60))
    beside, elsewhere = np.eye(4), np.eye(4)
    beside[0, 3], elsewhere[0, 3] = 0.02, 5.0

    def confidence(index: int, pose: np.ndarray) -> np.ndarray:
        moved = replace(frame, index=index, world_from_camera=pose)
        return np.array([detector(seed)(moved).confidence[:1].sum() for seed in range(150)])

    here = confidence(0, np.eye(4))
    assert np.corrcoef(here, confidence(1, beside))[0, 1] > 0.25
    assert abs(np.corrcoef(here, confidence(1, elsewhere))[0, 1]) < 0.2


def test_things_are_connected_components_cut_at_depth_jumps(frames: list[SensorFrame]) -> None:
    labels = frames[0].labels
    assert labels is not None
    numbers, things = find_things(labels, np.zeros(labels.shape, np.float32))
    sizes = np.bincount(numbers.reshape(-1))
    assert len(things) > 10
    for label in np.unique(labels[labels > 0]):
        reference, count = ndimage.label(labels == label)
        assert len(np.unique(numbers[labels == label])) == count
        assert (
            len(np.unique(numbers[labels == label] * (count + 1) + reference[labels == label]))
            == count
        )
    assert [t.number for t in things] == [n for n in range(1, len(sizes)) if sizes[n] >= 40]
    one = painted(square(1, 40))
    one.depth[:, 170:] = 3.0
    assert len(find_things(one.labels, one.depth)[1]) == 2
    one.depth[:] = np.linspace(1, 3, CAMERA.width)
    assert len(find_things(one.labels, one.depth)[1]) == 1


def test_an_image_of_one_class_and_an_empty_one_pass() -> None:
    empty = detector()(painted(square(0, 10)))
    assert len(empty) == 0
    assert empty.relevance.shape == (0, len(PROMPTS))
    assert empty.embeddings.shape == (0, 512)
    full = np.full((CAMERA.height, CAMERA.width), LABELS["sofa"])
    for seed in range(10):
        regions = detector(seed, strength=0.5)(painted(full))
        assert (np.bincount(regions.owner.reshape(-1)) > 0).any()


def test_unregistered_depth_is_done_without(frames: list[SensorFrame]) -> None:
    small = replace(frames[0], depth=frames[0].depth[::2, ::2])
    assert len(detector()(small)) > 5


def test_counts_by_hand() -> None:
    labels = np.array([[1, 1, 2, 0], [1, 1, 3, 2]], np.uint16)
    owner = np.array([[1, 1, 2, 2], [2, 0, 1, 0]], np.uint16)
    regions = Regions(
        boxes=np.zeros((2, 4), np.float32),
        levels=np.zeros(2, np.uint8),
        relevance=np.array([[0.8, 0.1], [0.1, 0.3]], np.float32),
        embeddings=np.zeros((2, 512), np.float16),
        owner=owner,
        is_box=np.zeros(2, bool),
    )
    names = {0: "nothing", 1: "sofa", 2: "lamp", 3: "wall"}
    asked = count_labels(regions, labels, names, ("couch", "lamp"))
    assert asked == LabelCounts(labelled=6, found=4, right=3)
    assert count_labels(regions, labels, names, ("couch", "lamp"), 0.4) == LabelCounts(6, 2, 2)
    assert (asked.accuracy, asked.precision, asked.coverage) == (3 / 6, 3 / 4, 4 / 6)


def test_what_a_user_can_get_wrong_is_said(frames: list[SensorFrame]) -> None:
    with pytest.raises(ProgroundError, match="'chair'"):
        detector(task=Task("t", ("chiar",)))
    with pytest.raises(ProgroundError, match=r"frame 0: .*no ground-truth labels"):
        detector()(replace(frames[0], labels=None))
    with pytest.raises(ProgroundError, match="have shape"):
        detector()(replace(frames[0], labels=np.zeros((4, 4), np.uint16)))
