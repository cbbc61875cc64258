"""How alike two pictures look, beyond the errors of their single pixels."""

from __future__ import annotations

import cv2
import numpy as np
import torch

WINDOW = 11
"""Side in pixels of the Gaussian window (sigma 1.5) that a pixel is judged with."""


def structural_similarity(
    rendered: np.ndarray, taken: np.ndarray, judged: np.ndarray
) -> float | None:
    """Mean SSIM of two pictures, over the pixels whose whole window is to be judged.

    Wang et al., Image quality assessment: from error visibility to structural similarity, 2004:
    each colour channel by itself, local moments under a Gaussian window.

    Args:
        rendered, taken: uint8 [H, W, 3] RGB.
        judged: bool [H, W]; what the pictures show elsewhere has no influence.

    Returns:
        1 where the pictures are equal, about 0 where they have nothing in common; None where no
        window lies within the judged pixels.
    """
    # Beyond the edge of the picture nothing is judged.
    inner = cv2.erode(judged.astype(np.uint8), np.ones((WINDOW, WINDOW)), borderValue=0)
    if not inner.any():
        return None
    # Only here, since it takes half a second to import.
    from kornia.metrics import ssim

    # In float64, since a variance is a small difference of large squares; with nothing added to the
    # denominator, which cannot be 0, so that equal pictures have exactly 1.
    first, second = (
        torch.from_numpy(picture.astype(np.float64) / 255).permute(2, 0, 1)[None]
        for picture in (rendered, taken)
    )
    similarity = ssim(first, second, WINDOW, max_val=1.0, eps=0.0)[0].numpy()
    return float(similarity[:, inner > 0].mean())
