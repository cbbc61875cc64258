"""Pictures as the recording keeps them: JPEG for colour, PNG in millimetres for depth.

False colours and probabilities keep their exact values.
"""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

JPEG_QUALITY = 85
COLOR_ERROR_MAX = 64
"""Mean absolute difference of the channels, of 255, at the bright end of the colour map."""
DEPTH_ERROR_MAX_M = 0.2
"""Depth error at the bright end of the colour map; the same in all recordings, to compare."""
MM_PER_M = 1000.0


def fit_width(image: np.ndarray, width: int) -> np.ndarray:
    """The image [H, W, ...], shrunk to `width` pixels where it is wider, its aspect kept."""
    if image.shape[1] <= width:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def jpeg(rgb: np.ndarray) -> rr.EncodedImage:
    """A colour image, uint8 [H, W, 3] RGB, compressed."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")


def false_colors(rgb: np.ndarray) -> rr.EncodedImage:
    """Colours with a meaning of their own, uint8 [H, W, 3] RGB, compressed without loss."""
    return rr.EncodedImage(contents=_png(rgb[..., ::-1]), media_type="image/png")


def probability(values: np.ndarray) -> rr.DepthImage:
    """An image of values from 0 to 1, float32 [H, W], as a heat map."""
    colormap = rr.components.Colormap.Inferno
    return rr.DepthImage(values, meter=1.0, colormap=colormap, depth_range=(0.0, 1.0))


def depth(depth_m: np.ndarray, far_m: float) -> rr.EncodedDepthImage:
    """A depth image, float32 [H, W] metres, 0 where there is nothing, kept in whole millimetres.

    Args:
        depth_m: the image.
        far_m: depth at the end of the colour map.
    """
    return _millimetres(depth_m, far_m, rr.components.Colormap.Turbo)


def depth_error(depth_m: np.ndarray, rendered_m: np.ndarray) -> rr.EncodedDepthImage:
    """|rendered - measured| depth, [H, W] metres; dark where either has nothing."""
    known = (depth_m > 0) & (rendered_m > 0)
    error_m = np.where(known, np.abs(rendered_m - depth_m), 0.0)
    return _millimetres(error_m, DEPTH_ERROR_MAX_M, rr.components.Colormap.Inferno)


def color_error(rgb: np.ndarray, rendered: np.ndarray) -> np.ndarray:
    """Mean absolute difference of the channels of two images, as a heat map; all uint8 [H, W, 3].

    Dark where the sensor saw nothing, that is, where the first image is black.
    """
    mean_of_channels = np.full((1, 3), 255.0 / COLOR_ERROR_MAX / 3)
    scaled = cv2.transform(cv2.absdiff(rgb, rendered), mean_of_channels)
    scaled[~rgb.any(axis=2)] = 0
    heat = cv2.applyColorMap(scaled, cv2.COLORMAP_INFERNO)
    return np.asarray(cv2.cvtColor(heat, cv2.COLOR_BGR2RGB))


def _millimetres(
    values_m: np.ndarray, far_m: float, colormap: rr.components.Colormap
) -> rr.EncodedDepthImage:
    mm = np.clip(np.rint(values_m * MM_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
    return rr.EncodedDepthImage(
        _png(mm),
        media_type="image/png",
        meter=MM_PER_M,
        colormap=colormap,
        depth_range=(0.0, far_m * MM_PER_M),
    )


def _png(image: np.ndarray) -> bytes:
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return data.tobytes()
