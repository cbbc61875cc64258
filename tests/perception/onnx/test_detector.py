"""The detector file: what keeps the contract is used, what breaks it is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import numpy_helper
from scipy.special import expit, logit

from proground_log.errors import ProgroundError
from proground_log.perception.onnx.detector import Detections, Detector
from proground_log.perception.onnx.yolo import MOST_BOXES, distinct_boxes
from tests.perception.onnx.tiny_yolo import ANCHORS, LEVELS, SIDE, WIDTH, TinyDetector

IMAGE = np.zeros((SIDE, SIDE, 3), np.uint8)
TEXTS = np.eye(3, WIDTH, dtype=np.float32)


def with_relevance(relevance: np.ndarray, **changes: object) -> TinyDetector:
    """A detector whose relevance to the first texts is this, float [A, K]."""
    embeddings = np.zeros((ANCHORS, WIDTH), np.float32)
    embeddings[:, : relevance.shape[1]] = logit(relevance)
    return TinyDetector(
        embeddings=embeddings,
        scale=np.ones((3, WIDTH), np.float32),
        shift=np.zeros((3, WIDTH), np.float32),
        logit_scale=np.zeros(3, np.float32),
        bias=np.zeros(3, np.float32),
        **changes,  # type: ignore[arg-type]
    )


def find(
    path: Path, detector: TinyDetector, texts: np.ndarray = TEXTS, image: np.ndarray = IMAGE
) -> Detections:
    return Detector(detector.write(path / "d.onnx")).detect(
        image, texts, least_relevance=0.3, most_overlap=0.7
    )


def test_what_it_finds(tmp_path: Path) -> None:
    relevance = np.full((ANCHORS, 3), 0.01)
    relevance[70] = 0.1, 0.8, 0.2
    relevance[5] = 0.9, 0.1, 0.1
    relevance[81] = 0.29, 0.29, 0.29
    relevance[40] = 0.2, 0.2, 0.4
    tiny = with_relevance(relevance)
    tiny.boxes[70] = 0, 10, 40, 70
    found = find(tmp_path, tiny)
    np.testing.assert_allclose(found.relevance, relevance[[5, 70, 40]], rtol=1e-5)
    assert found.levels.tolist() == [0, 1, 0]
    np.testing.assert_array_equal(found.embeddings, tiny.embeddings[[5, 70, 40]].astype("f2"))
    np.testing.assert_array_equal(found.boxes[1], [0, 10, 40, 64])
    dtypes = [a.dtype for a in (found.boxes, found.levels, found.relevance, found.embeddings)]
    assert dtypes == [np.float32, np.uint8, np.float32, np.float16]
    assert found.segments is None


def test_boxes_that_overlap_are_one_region_whatever_they_are_relevant_to(tmp_path: Path) -> None:
    relevance = np.full((ANCHORS, 3), 0.01)
    relevance[3, 0], relevance[66, 1], relevance[20, 2] = 0.7, 0.8, 0.6
    tiny = with_relevance(relevance)
    tiny.boxes[[3, 66, 20]] = [[10, 10, 30, 30], [11, 10, 31, 30], [20, 10, 40, 30]]
    assert find(tmp_path, tiny).relevance.argmax(axis=1).tolist() == [1, 2]


def test_equal_relevance_leaves_the_lower_anchor(tmp_path: Path) -> None:
    relevance = np.full((ANCHORS, 3), 0.01)
    relevance[[60, 12, 33], [0, 1, 2]] = 0.75
    tiny = with_relevance(relevance)
    tiny.boxes[[60, 33]] = 10, 10, 30, 30
    assert find(tmp_path, tiny).relevance.argmax(axis=1).tolist() == [1, 2]


def test_boxes_lie_in_the_image_and_those_in_the_padding_are_left_out(tmp_path: Path) -> None:
    relevance = np.full((ANCHORS, 3), 0.01)
    relevance[[0, 1, 2], 0] = 0.9, 0.8, 0.7
    tiny = with_relevance(relevance)
    tiny.boxes[:3] = [[0, 0, 64, 15], [10, 20, 30, 40], [50, 10, 70, 40]]
    found = find(tmp_path, tiny, image=np.zeros((64, 128, 3), np.uint8))
    np.testing.assert_array_equal(found.boxes, [[20, 8, 60, 48], [100, 0, 128, 48]])


def test_masks_go_with_their_boxes(tmp_path: Path) -> None:
    relevance = np.full((ANCHORS, 3), 0.01)
    relevance[[7, 50], 0] = 0.6, 0.9
    tiny = with_relevance(relevance, without=())
    segments = find(tmp_path, tiny).segments
    assert segments is not None
    np.testing.assert_array_equal(segments.boxes, tiny.boxes[[50, 7]])
    np.testing.assert_array_equal(segments.coefficients, tiny.coefficients[[50, 7]])
    np.testing.assert_array_equal(segments.prototypes, tiny.prototypes)


def test_nothing_found(tmp_path: Path) -> None:
    found = find(tmp_path, with_relevance(np.full((ANCHORS, 3), 0.01), without=()))
    assert len(found) == 0
    assert found.relevance.shape == (0, 3)
    assert found.embeddings.shape == (0, WIDTH)
    assert found.boxes.shape == (0, 4)


@given(
    st.lists(
        st.tuples(*[st.integers(0, 12)] * 2, *[st.integers(1, 12)] * 2, st.integers(1, 5)),
        max_size=40,
    ),
    st.sampled_from([0.0, 0.25, 0.5, 0.7, 1.0]),
)
def test_distinct_boxes_are_those_of_the_definition(
    found: list[tuple[int, ...]], most_overlap: float
) -> None:
    corners = np.array(found, np.float32).reshape(-1, 5)
    boxes = np.concatenate([corners[:, :2], corners[:, :2] + corners[:, 2:4]], axis=1)
    scores = corners[:, 4] / np.float32(5)

    def overlap(a: np.ndarray, b: np.ndarray) -> float:
        size = np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0)
        shared = float(size[0]) * float(size[1])
        return shared / (float(np.prod(a[2:] - a[:2])) + float(np.prod(b[2:] - b[:2])) - shared)

    expected: list[int] = []
    for row in sorted(range(len(boxes)), key=lambda row: -scores[row]):
        if all(overlap(boxes[row], boxes[other]) <= most_overlap + 1e-12 for other in expected):
            expected.append(row)
    assert distinct_boxes(boxes, scores, most_overlap).tolist() == expected


def test_at_most_300_boxes_stay() -> None:
    low = np.arange(400, dtype=np.float32)[:, None] * [10, 0]
    scores = np.linspace(0.1, 0.9, 400).astype(np.float32)
    rows = distinct_boxes(np.concatenate([low, low + 5], axis=1), scores, 0.5)
    assert rows.tolist() == list(range(399, 399 - MOST_BOXES, -1))


def test_its_heads_are_read(tmp_path: Path) -> None:
    tiny = TinyDetector()
    heads = Detector(tiny.write(tmp_path / "d.onnx")).heads
    np.testing.assert_array_equal(heads.scale, tiny.scale)
    np.testing.assert_array_equal(heads.shift, tiny.shift)
    np.testing.assert_array_equal(heads.logit_scale, tiny.logit_scale)
    np.testing.assert_array_equal(heads.bias, tiny.bias)


def swapped(array: np.ndarray, place: tuple[int, ...], value: float) -> np.ndarray:
    array = array.copy()
    array[place] = value
    return array


FULL = TinyDetector()
NAN = float("nan")


@pytest.mark.parametrize(
    ("tiny", "message"),
    [
        (TinyDetector(true_bias=np.float32([-1, -1.9, 0.5])), "P4 .* off by up to 0.1"),
        (TinyDetector(true_bias=np.float32([-1, -2, 0.47])), "P5 .* off by up to 0.03"),
        (TinyDetector(without=("head_bias",)), "no output 'head_bias'"),
        (TinyDetector(without=("embeddings",)), "no output 'embeddings'"),
        (TinyDetector(without=("logits",)), "no output 'logits'"),
        (TinyDetector(without=("mask_prototypes",)), "only one of"),
        (TinyDetector(embeddings=FULL.embeddings[:, :256]), "embeddings.*256.*512"),
        (TinyDetector(boxes=FULL.boxes[:-1]), r"boxes.*83.*84"),
        (TinyDetector(side=80), "80 x 80"),
        (TinyDetector(side=96), r"boxes.*84, 4.*189, 4"),
        (TinyDetector(side="S"), "fixed square"),
        (TinyDetector(prototypes=FULL.prototypes[:, :8], without=()), "mask_prototypes.*8, 16"),
        (TinyDetector(boxes=swapped(FULL.boxes, (3, 1), NAN)), "boxes.*not finite"),
        (TinyDetector(embeddings=swapped(FULL.embeddings, (3, 1), NAN)), "not finite"),
        (TinyDetector(metadata={}), "proground.contract = None.*not 1"),
        (TinyDetector(metadata={"proground.contract": "2"}), "proground.contract = 2.*not 1"),
    ],
)
def test_a_file_that_breaks_the_contract_is_refused(
    tmp_path: Path, tiny: TinyDetector, message: str
) -> None:
    path = tiny.write(tmp_path / "broken.onnx")
    with pytest.raises(ProgroundError, match=message) as error:
        Detector(path)
    assert error.value.where == str(path)


def test_an_embedding_beyond_float16_is_an_error(tmp_path: Path) -> None:
    relevance = np.full((ANCHORS, 3), 0.9)
    tiny = with_relevance(relevance)
    tiny.embeddings[0, 400] = 1e5
    tiny.scale[:, 400] = 0
    with pytest.raises(ProgroundError, match="beyond float16"):
        find(tmp_path, tiny)


@pytest.fixture(scope="module")
def real_path(shared_data: Path) -> Path:
    path = shared_data.parent / "models" / "yolov8n-seg-conse.onnx"
    if not path.is_file():
        pytest.skip(f"no detector {path}")
    return path


def test_a_real_detector_gives_the_logits_of_its_heads(real_path: Path) -> None:
    detector = Detector(real_path)
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    texts = np.random.default_rng(1).normal(size=(4, WIDTH)).astype(np.float32)
    texts /= np.linalg.norm(texts, axis=1, keepdims=True)
    found = detector.detect(image, texts, least_relevance=0.0, most_overlap=0.7)
    assert detector.has_masks
    assert len(found) > 50
    for level in range(3):
        here = found.levels == level
        relevance = expit(detector.heads.logits(found.embeddings[here], level, texts))
        np.testing.assert_allclose(found.relevance[here], relevance, atol=1e-3)


@pytest.mark.parametrize("tensor", ["head_bias", "head_shift"])
def test_a_real_detector_with_a_wrong_head_is_refused(
    real_path: Path, tmp_path: Path, tensor: str
) -> None:
    model = onnx.load(real_path)
    output = next(node for node in model.graph.node if tensor in node.output)
    output.output[list(output.output).index(tensor)] = "right"
    shape = (3,) if tensor == "head_bias" else (3, WIDTH)
    wrong = numpy_helper.from_array(np.full(shape, 0.5, np.float32), tensor)
    model.graph.initializer.append(wrong)
    path = tmp_path / "wrong.onnx"
    onnx.save(model, path)
    with pytest.raises(ProgroundError, match="logits on level P3"):
        Detector(path)


def test_levels_are_in_the_order_of_the_anchors(tmp_path: Path) -> None:
    relevance = np.repeat(np.linspace(0.9, 0.4, ANCHORS)[:, None], 3, axis=1)
    tiny = with_relevance(relevance)
    tiny.boxes[64:] = 0
    tiny.boxes[64:, 0], tiny.boxes[64:, 2], tiny.boxes[64:, 3] = (
        np.arange(20) * 3,
        np.arange(20) * 3 + 2,
        2,
    )
    levels = find(tmp_path, tiny).levels
    np.testing.assert_array_equal(levels, LEVELS)
