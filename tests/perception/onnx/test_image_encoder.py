"""The image encoder sees what CLIP would see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.errors import ProgroundError
from proground_log.perception.onnx.image_encoder import OnnxImageEncoder, pixel_values
from tests.perception.onnx.tiny_encoders import write_image_encoder


def smooth_image(height: int, width: int) -> np.ndarray:
    """A picture without sharp edges, another in each channel."""
    y, x = np.mgrid[:height, :width] / 40
    return np.stack([127 + 100 * np.sin(x + k) * np.cos(y - k) for k in range(3)], 2).astype(
        np.uint8
    )


def middle_square(image: np.ndarray) -> np.ndarray:
    """The same as `pixel_values`, by torch's own smoothing resize, before normalization."""
    height, width = image.shape[:2]
    size = [int(224 * side / min(height, width)) for side in (height, width)]
    resized = torch.nn.functional.interpolate(
        torch.from_numpy(image).permute(2, 0, 1)[None].float(),
        size,
        mode="bicubic",
        antialias=True,
    )[0].clamp(0, 255)
    top, left = (round((side - 224) / 2) for side in size)
    return resized[:, top : top + 224, left : left + 224].numpy() / 255


@settings(max_examples=20, deadline=None)
@given(st.integers(30, 700), st.integers(30, 700))
def test_the_middle_square_is_resized_and_normalized(height: int, width: int) -> None:
    image = smooth_image(height, width)
    mean = np.array([0.48145466, 0.4578275, 0.40821073]).reshape(3, 1, 1)
    deviation = np.array([0.26862954, 0.26130258, 0.27577711]).reshape(3, 1, 1)
    seen = pixel_values(image)
    assert (seen.dtype, seen.shape) == (np.float32, (3, 224, 224))
    np.testing.assert_allclose(seen * deviation + mean, middle_square(image), atol=1.5 / 255)


def test_a_square_of_the_right_size_is_left_as_it_is() -> None:
    image = smooth_image(224, 224)
    wide = np.concatenate([np.zeros((224, 50, 3), np.uint8), image, image[:, :50]], axis=1)
    np.testing.assert_array_equal(pixel_values(wide), pixel_values(image))


def test_an_embedding_is_the_networks_at_length_1(tmp_path: Path) -> None:
    weights = write_image_encoder(tmp_path / "image.onnx")
    image = smooth_image(300, 400)
    expected = pixel_values(image).mean((1, 2), dtype=np.float64) @ weights.astype(np.float64)
    embedding = OnnxImageEncoder(tmp_path / "image.onnx").embed(image)
    np.testing.assert_allclose(embedding, expected / np.linalg.norm(expected), atol=1e-4)
    assert (embedding.dtype, embedding.shape) == (np.float32, (512,))


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((5, 5), np.uint8),
        np.zeros((5, 5, 4), np.uint8),
        np.zeros((5, 5, 3), np.float32),
        np.zeros((0, 5, 3), np.uint8),
    ],
)
def test_what_is_no_image_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ProgroundError, match="not uint8"):
        pixel_values(image)


def test_an_encoder_for_another_size_is_refused(tmp_path: Path) -> None:
    write_image_encoder(tmp_path / "image.onnx", side=336)
    with pytest.raises(ProgroundError, match=r"shape \[N, 3, 336, 336\], not \[1, 3, 224, 224\]"):
        OnnxImageEncoder(tmp_path / "image.onnx")
