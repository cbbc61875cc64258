"""How well a map renders views it was not shown, and how close its mesh comes to the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from proground_log.evaluation.picture_quality import structural_similarity
from proground_log.frame import Frame
from proground_log.mapping.map import Map

FARTHEST_M = 5.0
"""Depth beyond this is not judged: the sensor's own error there is of the size of a map's."""
COMPLETION_M = 0.05


@dataclass(frozen=True)
class ViewScore:
    """How one held-out view is reproduced.

    Args:
        frame_index: number of the frame in its log.
        color_mse: mean squared error of the colour in [0, 1], over pixels with colour and depth;
            None where there is no such pixel.
        depth_l1_m: mean absolute error of the depth, over valid depths under 5 m that were hit;
            None where none was.
        missed: share of those depths where the map has no surface; None where there is no depth.
        ssim: structural similarity of the colour over the same pixels as its error, as far as
            they lie together; None where no window fits among them.
    """

    frame_index: int
    color_mse: float | None
    depth_l1_m: float | None
    missed: float | None
    ssim: float | None

    @property
    def psnr_db(self) -> float | None:
        """Peak signal-to-noise ratio of the colour; infinite where it is equal."""
        if self.color_mse is None:
            return None
        return -10 * math.log10(self.color_mse) if self.color_mse else math.inf


def score_view(mapped: Map, frame: Frame) -> ViewScore:
    """Render the frame's view at full size, without its depth, and compare."""
    view = mapped.render(frame.camera, frame.world_from_camera, antialias=True)
    measured = frame.depth_m > 0
    judged = measured & frame.color_valid
    error = (view.color.astype(np.float64) - frame.color)[judged] / 255
    close = measured & (frame.depth_m < FARTHEST_M)
    hit = close & (view.depth_m > 0)
    return ViewScore(
        frame_index=frame.index,
        color_mse=_mean(np.square(error)),
        depth_l1_m=_mean(np.abs(view.depth_m - frame.depth_m)[hit]),
        missed=_mean(~hit[close]),
        ssim=structural_similarity(view.color, frame.color, judged),
    )


def view_summary(scores: Iterable[ViewScore]) -> dict[str, float]:
    """Each figure's mean over the views that have it, as far as there are any.

    PSNR is the mean of the views' PSNRs.
    """
    scores = list(scores)
    figures = {
        "psnr_db": (1, [s.psnr_db for s in scores]),
        "ssim": (1, [s.ssim for s in scores]),
        "depth_l1_cm": (100, [s.depth_l1_m for s in scores]),
        "missed_percent": (100, [s.missed for s in scores]),
    }
    means = {
        name: scale * float(np.mean(known))
        for name, (scale, values) in figures.items()
        if (known := [value for value in values if value is not None])
    }
    return {"views": len(scores), **means}


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


def mesh_scores(vertices_m: np.ndarray, true_vertices_m: np.ndarray) -> dict[str, float]:
    """Accuracy and completion of a mesh against the true one, by their vertices.

    Args:
        vertices_m: [V, 3] of the map's mesh.
        true_vertices_m: [T, 3] of the ground truth, surface that the camera saw.

    Returns:
        accuracy_cm: mean distance from a vertex to the nearest true one; completion_cm: the other
        way round; completion_percent: share of true vertices with one of the map within 5 cm.
    """
    accuracy_m = np.asarray(cKDTree(true_vertices_m).query(vertices_m)[0])
    completion_m = np.asarray(cKDTree(vertices_m).query(true_vertices_m)[0])
    return {
        "accuracy_cm": 100 * float(accuracy_m.mean()),
        "completion_cm": 100 * float(completion_m.mean()),
        "completion_percent": 100 * float((completion_m < COMPLETION_M).mean()),
    }
