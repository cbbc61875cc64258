"""From a frame to its regions, with real networks and with tiny ones."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import logit

from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.onnx.perceiver import OnnxPerception
from proground_log.perception.onnx.segmenter import Segmenter
from proground_log.perception.task import Task
from proground_log.perception.vocabulary import Vocabulary
from proground_log.regions import Regions
from tests.perception.onnx.tiny_yolo import ANCHORS, SIDE, WIDTH, TinyDetector, write_segmenter

TASK = Task("two things", ("first", "second"), irrelevant=("third",))


class Axes:
    """Texts along the axes."""

    origin = {"kind": "axes"}  # noqa: RUF012 -- as a text space has it

    def embed(self, names: Sequence[str]) -> np.ndarray:
        return np.eye(len(names), WIDTH, dtype=np.float32)


def frame_of(color: bytes, color_format: str) -> SensorFrame:
    depth = np.zeros((2, 2), np.uint16)
    return SensorFrame(7, 0, 0, color, color_format, depth, np.eye(4))


def black_frame(width: int, height: int) -> SensorFrame:
    _, png = cv2.imencode(".png", np.zeros((height, width, 3), np.uint8))
    return frame_of(png.tobytes(), "png")


def two_things(path: Path, *, has_masks: bool) -> Path:
    """A detector of a box (0.9) inside a larger one (0.6); masks are the image's left half."""
    embeddings = np.full((ANCHORS, WIDTH), 0, np.float32)
    embeddings[:, :3] = logit(0.01)
    embeddings[2, 0], embeddings[70, 1] = logit(0.6), logit(0.9)
    tiny = TinyDetector(
        embeddings=embeddings,
        scale=np.ones((3, WIDTH), np.float32),
        shift=np.zeros((3, WIDTH), np.float32),
        logit_scale=np.zeros(3, np.float32),
        bias=np.zeros(3, np.float32),
        coefficients=np.ones((ANCHORS, 32), np.float32),
        prototypes=np.broadcast_to(left_half(), (32, 16, 16)).astype(np.float32),
        without=() if has_masks else ("mask_coefficients", "mask_prototypes"),
    )
    tiny.boxes[2], tiny.boxes[70] = (0, 0, 64, 64), (8, 8, 28, 28)
    return tiny.write(path / "detector.onnx")


def left_half() -> np.ndarray:
    return np.where(np.arange(16) < 8, 1, -1) * np.ones((16, 1))


def expected_owner() -> np.ndarray:
    owner = np.zeros((SIDE, SIDE), np.uint16)
    owner[:, :31] = 2
    owner[7:29, 7:29] = 0
    owner[9:27, 9:27] = 1
    return owner


def test_the_detectors_own_masks(tmp_path: Path) -> None:
    perceive = OnnxPerception(TASK, Axes(), two_things(tmp_path, has_masks=True))
    regions = perceive(black_frame(SIDE, SIDE))
    assert regions.labels.tolist() == [1, 0]
    assert regions.levels.tolist() == [1, 0]
    np.testing.assert_allclose(regions.confidence, [0.9, 0.6], rtol=1e-5)
    np.testing.assert_array_equal(regions.owner, expected_owner())
    assert not regions.is_box.any()


def test_a_segmenters_masks(tmp_path: Path) -> None:
    # Of the larger thing's size, in its left half; none fits the smaller thing.
    segmenter = write_segmenter(
        tmp_path / "segmenter.onnx",
        boxes=np.float32([[0, 0, 64, 64], [40, 40, 60, 60], [8, 8, 28, 28]]),
        scores=np.float32([0.8, 0.9, 0.1]),
        coefficients=np.ones((3, 32), np.float32),
        prototypes=np.broadcast_to(left_half(), (32, 16, 16)),
    )
    detector = two_things(tmp_path, has_masks=False)
    regions = OnnxPerception(TASK, Axes(), detector, segmenter)(black_frame(SIDE, SIDE))
    np.testing.assert_array_equal(regions.owner, expected_owner())
    assert regions.is_box.tolist() == [True, False]


def test_a_detector_without_masks_needs_a_segmenter(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="gives no masks"):
        OnnxPerception(TASK, Axes(), two_things(tmp_path, has_masks=False))


@pytest.mark.parametrize(
    ("without", "cells", "message"),
    [
        (("scores",), 16, "no output 'scores'"),
        (("mask_prototypes",), 16, "no output 'mask_prototypes'"),
        ((), 8, r"mask_prototypes.*8, 8.*16, 16"),
    ],
)
def test_a_segmenter_that_breaks_the_contract_is_refused(
    tmp_path: Path, without: tuple[str, ...], cells: int, message: str
) -> None:
    path = write_segmenter(
        tmp_path / "broken.onnx",
        boxes=np.zeros((3, 4), np.float32),
        scores=np.zeros(3, np.float32),
        coefficients=np.zeros((3, 32), np.float32),
        prototypes=np.zeros((32, cells, cells), np.float32),
        without=without,
    )
    with pytest.raises(ProgroundError, match=message):
        Segmenter(path)


def test_the_description_says_what_made_the_regions(tmp_path: Path) -> None:
    path = two_things(tmp_path, has_masks=True)
    description = OnnxPerception(TASK, Axes(), path).description
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    assert description.origin == {
        "kind": "onnx",
        "detector": "detector.onnx",
        "detector.sha256": sha256,
        "texts.kind": "axes",
    }
    assert description.task == TASK
    np.testing.assert_array_equal(description.texts, np.eye(3, WIDTH))
    read = PerceptionDescription.from_bytes(description.to_bytes(), where="here")
    assert read.to_bytes() == description.to_bytes()


def test_a_broken_image_is_named(tmp_path: Path) -> None:
    perceive = OnnxPerception(TASK, Axes(), two_things(tmp_path, has_masks=True))
    with pytest.raises(ProgroundError, match="frame 7"):
        perceive(frame_of(b"\xff\xd8 no image", "jpeg"))


@pytest.fixture(scope="module")
def models(shared_data: Path) -> Path:
    folder = shared_data.parent / "models"
    if not folder.is_dir():
        pytest.skip(f"no models in {folder}")
    return folder


def kitchen(shared_data: Path, models: Path, *, has_segmenter: bool) -> Regions:
    task = Task("kitchen", ("chair", "cup", "television", "dining table", "sink", "bottle"))
    perceive = OnnxPerception(
        task,
        Vocabulary(models / "clip-vit-b32-vocabulary.npz"),
        models / "yolov8n-seg-conse.onnx",
        models / "yolov8n-seg-classless.onnx" if has_segmenter else None,
    )
    color = shared_data / "7scenes_redkitchen" / "seq-01" / "frame-000300.color.jpg"
    return perceive(frame_of(color.read_bytes(), "jpeg"))


@pytest.mark.parametrize("has_segmenter", [False, True])
def test_real_networks_on_a_real_image(
    shared_data: Path, models: Path, has_segmenter: bool
) -> None:
    regions = kitchen(shared_data, models, has_segmenter=has_segmenter)
    count = len(regions)
    dtypes = {"boxes": "f4", "levels": "u1", "relevance": "f4", "embeddings": "f2"}
    shapes = {"boxes": (4,), "levels": (), "relevance": (6,), "embeddings": (WIDTH,)}
    for name, dtype in dtypes.items():
        assert getattr(regions, name).dtype == dtype
        assert getattr(regions, name).shape == (count, *shapes[name])
    assert regions.owner.dtype == np.uint16
    assert regions.owner.shape == (480, 640)
    assert regions.owner.max() <= count
    assert (np.diff(regions.confidence) <= 0).all()
    assert regions.confidence.min() >= 0.05
    # Two chairs at a table that fills the lower half, seen by eye.
    sure = regions.labels[regions.confidence >= 0.35].tolist()
    assert sure.count(0) == 2
    table = 1 + regions.labels.tolist().index(3)
    assert (regions.owner[240:] == table).mean() > 0.5
    assert (regions.owner[:200] == table).mean() < 0.05
    for number, box in enumerate(regions.boxes):
        rows, columns = np.nonzero(regions.owner == number + 1)
        if len(rows):
            assert columns.min() + 0.5 >= box[0]
            assert columns.max() + 0.5 < box[2]
            assert rows.min() + 0.5 >= box[1]
            assert rows.max() + 0.5 < box[3]


def test_regions_are_the_same_bits_at_any_number_of_threads(
    shared_data: Path, models: Path
) -> None:
    before = cv2.getNumThreads()
    try:
        found = []
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            found.append(kitchen(shared_data, models, has_segmenter=True))
    finally:
        cv2.setNumThreads(before)
    for name in ("boxes", "levels", "relevance", "embeddings", "owner", "is_box"):
        first, second = (getattr(regions, name).tobytes() for regions in found)
        assert first == second
