"""The surface of the map, in several colours."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

from proground_log.events import MeshExtracted
from proground_log.query.mesh import Mesh


def coloured(mesh: Mesh | MeshExtracted, colors: np.ndarray) -> rr.Mesh3D:
    """The mesh in these colours, uint8 [V, 3] RGB."""
    return rr.Mesh3D(
        vertex_positions=mesh.vertices_m,
        triangle_indices=mesh.faces,
        vertex_normals=mesh.normals,
        vertex_colors=colors,
        # Seen from outside a room's walls and ceiling vanish, so that one looks in.
        face_rendering=rr.components.MeshFaceRendering.Front,
    )


def heat_colors(values: np.ndarray) -> np.ndarray:
    """Colours of values [V] from 0 (violet) to 1 (yellow): viridis, as RGB, uint8 [V, 3]."""
    scaled = np.rint(255 * values).astype(np.uint8)
    bgr = cv2.applyColorMap(scaled[:, None], cv2.COLORMAP_VIRIDIS)
    return np.asarray(bgr[:, 0, ::-1])
