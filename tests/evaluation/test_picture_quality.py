"""SSIM is scikit-image's where all is judged, and knows nothing of what is not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity as reference

from proground_log.camera import Camera
from proground_log.evaluation.picture_quality import WINDOW, structural_similarity
from proground_log.evaluation.reconstruction import ViewScore, score_view, view_summary
from proground_log.frame import Frame
from proground_log.streams import stream
from recorders.room import RoomSource

HALF = WINDOW // 2


def noise(seed: int, height: int = 40, width: int = 50) -> np.ndarray:
    return stream(seed, "picture").integers(256, size=(height, width, 3), dtype=np.uint8)


def reference_map(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """SSIM at every pixel and channel, by the independent implementation."""
    usual = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, each = reference(
        first / 255, second / 255, data_range=1, channel_axis=-1, full=True, **usual
    )
    return np.asarray(each)


@pytest.fixture(scope="module")
def picture(room: RoomSource) -> np.ndarray:
    return room.frame(0).decode_color()


@pytest.mark.parametrize("spoilt", ["noise", "blur", "brightness", "next frame", "all noise"])
def test_it_is_that_of_scikit_image(picture: np.ndarray, room: RoomSource, spoilt: str) -> None:
    first = noise(2, *picture.shape[:2]) if spoilt == "all noise" else picture
    other = {
        "noise": lambda: cv2.addWeighted(picture, 0.8, noise(1, *picture.shape[:2]), 0.2, 0),
        "blur": lambda: cv2.GaussianBlur(picture, None, 2.0),
        "brightness": lambda: cv2.add(picture, np.full_like(picture, 20)),
        "next frame": lambda: room.frame(1).decode_color(),
        "all noise": lambda: noise(3, *picture.shape[:2]),
    }[spoilt]()
    expected = reference_map(first, other)[HALF:-HALF, HALF:-HALF].mean()
    found = structural_similarity(first, other, np.ones(first.shape[:2], bool))
    assert found == pytest.approx(expected, abs=1e-9)
    assert found < 0.99


@pytest.mark.parametrize("level", [0, 7, 255])
def test_equal_pictures_have_one(picture: np.ndarray, level: int) -> None:
    for same in (picture, noise(0), np.full((30, 30, 3), level, np.uint8)):
        assert structural_similarity(same, same.copy(), np.ones(same.shape[:2], bool)) == 1


def test_only_pixels_with_a_whole_window_count() -> None:
    first, second = noise(0), cv2.addWeighted(noise(0), 0.7, noise(1), 0.3, 0)
    judged = np.ones((40, 50), bool)
    judged[18, 7] = judged[:, 40:] = judged[0, 25] = False
    # Slowly, and by the other implementation.
    each = reference_map(first, second)
    whole = [
        each[y, x]
        for y in range(HALF, 40 - HALF)
        for x in range(HALF, 50 - HALF)
        if judged[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].all()
    ]
    found = structural_similarity(first, second, judged)
    assert found == pytest.approx(np.mean(whole), abs=1e-9)

    first[~judged], second[~judged] = 255, 0
    assert structural_similarity(first, second, judged) == found


def test_where_no_window_fits_there_is_none() -> None:
    first, second = noise(0), noise(1)
    judged = np.zeros((40, 50), bool)
    judged[10 : 10 + WINDOW, 20 : 20 + WINDOW] = True
    expected = reference_map(first, second)[10 + HALF, 20 + HALF].mean()
    assert structural_similarity(first, second, judged) == pytest.approx(expected, abs=1e-9)
    judged[10, 20] = False
    assert structural_similarity(first, second, judged) is None
    for height, width in ((WINDOW - 1, 50), (40, WINDOW - 1), (1, 1)):
        small = noise(0, height, width)
        assert structural_similarity(small, small, np.ones((height, width), bool)) is None


def test_threads_do_not_change_a_bit(picture: np.ndarray) -> None:
    other, before = cv2.GaussianBlur(picture, None, 2.0), torch.get_num_threads()
    found = set()
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            found.add(structural_similarity(picture, other, np.ones(picture.shape[:2], bool)))
    finally:
        torch.set_num_threads(before)
    assert len(found) == 1


def test_a_view_is_judged_where_it_has_colour_and_depth() -> None:
    taken, rendered = noise(0), cv2.addWeighted(noise(0), 0.9, noise(1), 0.1, 0)
    depth_m, color_valid = np.full((40, 50), 2, np.float32), np.ones((40, 50), bool)
    depth_m[:, :15], color_valid[:, 35:] = 0, False
    frame = Frame(
        index=4,
        stamp_ns=0,
        camera=Camera(50, 40, 40.0, 40.0, 25.0, 20.0),
        world_from_camera=np.eye(4),
        depth_m=depth_m,
        color=taken,
        color_valid=color_valid,
        labels=None,
    )
    view = SimpleNamespace(color=rendered, depth_m=np.full((40, 50), 2, np.float32))
    content = SimpleNamespace(render=lambda *_, **__: view)
    score = score_view(content, frame)
    each = reference_map(rendered, taken)[HALF:-HALF, 15 + HALF : 35 - HALF]
    assert score.ssim == pytest.approx(each.mean(), abs=1e-9)

    rendered[:, :15], rendered[:, 35:] = 0, 255
    assert score_view(content, frame) == score


def test_the_mean_is_over_the_views_that_have_one() -> None:
    views = [
        ViewScore(index, 0.01, 0.02, 0.0, ssim) for index, ssim in enumerate((0.5, None, 0.75))
    ]
    assert view_summary(views)["ssim"] == 0.625
    assert view_summary(views)["psnr_db"] == pytest.approx(20)
    assert "ssim" not in view_summary(replace(view, ssim=None) for view in views)
