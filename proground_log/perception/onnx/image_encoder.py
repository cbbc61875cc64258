"""An image encoder (CLIP) as an ONNX file: a picture in the place of a text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from proground_log.errors import ProgroundError
from proground_log.perception.onnx.session import open_session
from proground_log.perception.texts import of_length_1
from proground_log.regions import EMBEDDING_WIDTH

SIDE = 224
"""Of the square that the encoder sees, in pixels."""
_MEAN = np.array([0.48145466, 0.4578275, 0.40821073], np.float32)
_DEVIATION = np.array([0.26862954, 0.26130258, 0.27577711], np.float32)
"""Of CLIP's training images, by channel, in 0..1."""


class OnnxImageEncoder:
    """Embeds images with a network.

    Args:
        path: an ONNX file with `pixel_values` float32 [N, 3, 224, 224] in and `embeddings`
            float32 [N, 512] out, of any length; N free, or 1.

    Raises:
        ProgroundError: the file breaks this contract.
    """

    def __init__(self, path: Path) -> None:
        self._model = open_session(
            path,
            kind="image encoder",
            inputs={"pixel_values": (1, 3, SIDE, SIDE)},
            outputs={"embeddings": (1, EMBEDDING_WIDTH)},
        )
        self.origin = {
            "kind": "image encoder",
            "file": path.name,
            "sha256": self._model.sha256,
        }

    def embed(self, image: np.ndarray) -> np.ndarray:
        """Embedding float32 [512] of length 1 of an image uint8 [H, W, 3] RGB.

        Raises:
            ProgroundError: it is no such image, or the network fails on it.
        """
        output = self._model.run({"pixel_values": pixel_values(image)[None]})["embeddings"]
        return of_length_1(output, where=self._model.path)[0]


def pixel_values(image: np.ndarray) -> np.ndarray:
    """What CLIP sees of an image uint8 [H, W, 3] RGB, float32 [3, 224, 224].

    The shorter side is resized to 224 (bicubic, smoothed when it shrinks), the middle square cut
    out, each channel brought to mean 0 and deviation 1.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise ProgroundError(
            f"is {image.dtype} {list(image.shape)}, not uint8 [H, W, 3]",
            where="the image to embed",
            todo="give it as RGB",
        )
    height, width = image.shape[:2]
    shorter = min(height, width)
    # In whole numbers and rounded down, as in CLIP's own preparation.
    height, width = SIDE * height // shorter, SIDE * width // shorter
    left, top = round((width - SIDE) / 2), round((height - SIDE) / 2)
    resized = Image.fromarray(image).resize((width, height), Image.Resampling.BICUBIC)
    square = np.asarray(resized.crop((left, top, left + SIDE, top + SIDE)), np.float32) / 255
    return np.ascontiguousarray(((square - _MEAN) / _DEVIATION).transpose(2, 0, 1))
