"""How well a map renders views it was not shown, and how close its mesh comes to the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from proground_log.frame import Frame
from proground_log.mapping.map_file import NeuralMap

FARTHEST_M = 5.0
"""Depth beyond this is not judged: the sensor's own error there is of the size of a map's."""
COMPLETION_M = 0.05


@dataclass(frozen=True)
class ViewScore:
    """How one held-out view is reproduced.

    Args:
        frame_index: number of the frame in its log.
        color_mse: mean squared error of the colour in [0, 1], over pixels with colour and depth.
        depth_l1_m: mean absolute error of the depth, over valid depths under 5 m that were hit.
        missed: share of those depths where the map has no surface.
    """

    frame_index: int
    color_mse: float
    depth_l1_m: float
    missed: float

    @property
    def psnr_db(self) -> float:
        """Peak signal-to-noise ratio of the colour."""
        return -10 * float(np.log10(self.color_mse))


def score_view(content: NeuralMap, frame: Frame) -> ViewScore:
    """Render the frame's view at full size, without its depth, and compare."""
    view = content.render(frame.camera, frame.world_from_camera, antialias=True)
    measured = frame.depth_m > 0
    judged = measured & frame.color_valid
    error = (view.color.astype(np.float64) - frame.color)[judged] / 255
    close = measured & (frame.depth_m < FARTHEST_M)
    hit = close & (view.depth_m > 0)
    return ViewScore(
        frame_index=frame.index,
        color_mse=float(np.square(error).mean()),
        depth_l1_m=float(np.abs(view.depth_m - frame.depth_m)[hit].mean()),
        missed=1 - float(hit.sum() / close.sum()),
    )


def view_summary(scores: Iterable[ViewScore]) -> dict[str, float]:
    """Means over the views; PSNR is the mean of the views' PSNRs."""
    scores = list(scores)
    return {
        "views": len(scores),
        "psnr_db": float(np.mean([s.psnr_db for s in scores])),
        "depth_l1_cm": 100 * float(np.mean([s.depth_l1_m for s in scores])),
        "missed_percent": 100 * float(np.mean([s.missed for s in scores])),
    }


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
