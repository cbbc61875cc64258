"""A picture of a frame's regions, for people."""

from __future__ import annotations

import cv2
import numpy as np

from proground_log.perception.task import Task
from proground_log.regions import Regions

_FAINTEST, _STRONGEST = 0.15, 0.6
"""How much of a pixel is tint where its region has relevance 0 and 1."""
_TEXT_HEIGHT_PX = 14
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85]


def draw_preview(color: np.ndarray, regions: Regions, task: Task) -> bytes:
    """The colour image with its regions, as JPEG.

    Masks are tinted in the colour of their best prompt, the stronger the more relevant. Regions
    that the mapper learns from also get box, prompt and relevance.

    Args:
        color: uint8 [H, W, 3] RGB.
        regions: what was found in it.
        task: what was looked for.
    """
    tints = np.concatenate([np.zeros((1, 3)), task.prompt_colors()[regions.labels]])
    strength = _FAINTEST + (_STRONGEST - _FAINTEST) * regions.confidence
    share = np.concatenate([np.zeros(1), strength])[regions.owner][..., None]
    picture = np.rint(color * (1 - share) + tints[regions.owner] * share).astype(np.uint8)
    # The most relevant last, on top.
    for number in np.flatnonzero(regions.confidence >= task.thresholds.relevance)[::-1]:
        prompt = task.all_prompts[regions.labels[number]]
        text = f"{prompt} {regions.confidence[number]:.2f}"
        tint = [int(value) for value in tints[number + 1]]
        left, top, right, bottom = (round(float(value)) for value in regions.boxes[number])
        cv2.rectangle(picture, (left, top), (right - 1, bottom - 1), tint, 1)
        for shadow, ink in (1, (0, 0, 0)), (0, (255, 255, 255)):
            place = left + 2 + shadow, top + _TEXT_HEIGHT_PX + shadow
            cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, ink)
    _, encoded = cv2.imencode(".jpg", picture[..., ::-1], _JPEG)
    return encoded.tobytes()
