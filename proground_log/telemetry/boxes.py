"""Upright boxes around things, as rerun draws them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from proground_log.mapping.boxes import OrientedBox


def boxes3d(
    boxes: Sequence[OrientedBox], labels: Sequence[str], colors: np.ndarray | tuple[int, int, int]
) -> rr.Boxes3D:
    """Wire frames of N boxes with their labels, in one colour or in one each (uint8 [N, 3])."""
    return rr.Boxes3D(
        centers=np.array([box.centre_m for box in boxes]).reshape(-1, 3),
        half_sizes=np.array([box.extent_m / 2 for box in boxes]).reshape(-1, 3),
        quaternions=[Rotation.from_matrix(box.axes.T).as_quat() for box in boxes],
        colors=colors,
        labels=list(labels),
        show_labels=True,
        fill_mode=rr.components.FillMode.MajorWireframe,
    )
