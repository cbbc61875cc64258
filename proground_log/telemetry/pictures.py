"""What telemetry gets to see of the map: rendered views and the surface."""

from __future__ import annotations

import cv2
import numpy as np

from proground_log.bounds import Bounds
from proground_log.events import (
    MeshExtracted,
    SemanticView,
    SurfaceMeaning,
    ViewRendered,
)
from proground_log.field.semantic_heads import NO_SUPERVISION
from proground_log.frame import Frame
from proground_log.mapping.map_file import NeuralMap
from proground_log.mapping.semantic_map import Semantics
from proground_log.perception.description import PerceptionDescription
from proground_log.query.grounding import (
    BACKGROUND,
    background_probability,
    relevance_to,
    vertex_logits,
)
from proground_log.query.mesh import extract_mesh
from proground_log.run.settings import TelemetryConfig
from proground_log.telemetry.semantic_colors import SemanticColors

MOST_LATTICE_POINTS = 1_000_000
"""Points of the lattice from which telemetry's meshes are made: a fraction of a second."""


class Pictures:
    """Renders views and meshes of a growing map.

    Args:
        config: how large, and which prompt's relevance.
        bounds: the map's box.
        perception: what its semantics mean; None where it has none.
    """

    def __init__(
        self, config: TelemetryConfig, bounds: Bounds, perception: PerceptionDescription | None
    ) -> None:
        self._config = config
        volume_m3 = float(bounds.size_m.prod())
        # In a house a lattice of the voxel asked for would be too large.
        self._voxel_m = max(config.mesh_voxel_m, (volume_m3 / MOST_LATTICE_POINTS) ** (1 / 3))
        self._meaning = _Meaning(perception) if perception is not None else None

    def view(self, content: NeuralMap, frame: Frame) -> ViewRendered:
        """The frame's view, as the map and as the sensor has it."""
        width = min(self._config.view_width, frame.camera.width)
        camera = frame.camera.scaled_to_width(width)
        rendered = content.render(camera, frame.world_from_camera)
        size = (camera.width, camera.height)
        seen = np.where(frame.color_valid[..., None], frame.color, np.uint8(0))
        meaning = None
        if self._meaning is not None and content.semantics and rendered.features is not None:
            semantics = content.semantics.decode(rendered.features)
            meaning = self._meaning.of_view(semantics, rendered.depth_m, frame, size)
        return ViewRendered(
            frame_index=frame.index,
            color=cv2.resize(seen, size, interpolation=cv2.INTER_AREA),
            # Depth must not be mixed across edges.
            depth_m=cv2.resize(frame.depth_m, size, interpolation=cv2.INTER_NEAREST),
            rendered_color=rendered.color,
            rendered_depth_m=rendered.depth_m,
            semantics=meaning,
        )

    def mesh(self, content: NeuralMap, frame_index: int) -> MeshExtracted:
        """The surface so far."""
        mesh = extract_mesh(content, self._voxel_m)
        meaning = None
        if self._meaning is not None and content.semantics and len(mesh.vertices_m):
            meaning = self._meaning.of_surface(content.semantics_at(mesh.vertices_m))
        return MeshExtracted(
            frame_index, mesh.vertices_m, mesh.faces, mesh.normals, mesh.colors, meaning
        )


class _Meaning:
    """Turns semantics into labels and colours."""

    def __init__(self, perception: PerceptionDescription) -> None:
        self._perception = perception
        self._colors = SemanticColors(perception)

    def of_view(
        self, semantics: Semantics, depth_m: np.ndarray, frame: Frame, size: tuple[int, int]
    ) -> SemanticView:
        shape = depth_m.shape
        hit = (depth_m > 0).reshape(-1)
        labels, _ = self._labels(semantics)
        levels = semantics.scale_logits.argmax(axis=1).astype(np.uint8)
        return SemanticView(
            labels=np.where(hit, labels, np.int16(-1)).reshape(shape),
            observed_labels=cv2.resize(
                _observed_labels(frame), size, interpolation=cv2.INTER_NEAREST
            ),
            features=(self._colors(semantics) * hit[:, None]).reshape(*shape, 3),
            levels=np.where(hit, levels, np.uint8(NO_SUPERVISION)).reshape(shape),
            uncertainty=np.where(hit, semantics.uncertainty, np.float32(1)).reshape(shape),
        )

    def of_surface(self, semantics: Semantics) -> SurfaceMeaning:
        labels, logits = self._labels(semantics)
        background = background_probability(semantics.scale_logits, semantics.uncertainty)
        return SurfaceMeaning(
            labels=labels,
            features=self._colors(semantics),
            relevance=relevance_to(logits[:, 0], logits.max(axis=1), background),
            prompt=self._perception.task.prompts[0],
        )

    def _labels(self, semantics: Semantics) -> tuple[np.ndarray, np.ndarray]:
        """Number of the best prompt, or -1 for background, int16 [N], and the logits [N, K]."""
        perception = self._perception
        logits = vertex_logits(
            semantics.embeddings, semantics.scale_logits, perception.heads, perception.texts
        )
        background = background_probability(semantics.scale_logits, semantics.uncertainty)
        return np.where(background >= BACKGROUND, -1, logits.argmax(axis=1)).astype(
            np.int16
        ), logits


def _observed_labels(frame: Frame) -> np.ndarray:
    """The best prompt of the region at each pixel, -1 for none, int16 [H, W]."""
    if frame.regions is None or frame.region_of is None:
        return np.full(frame.depth_m.shape, -1, np.int16)
    labels = np.append(frame.regions.labels, -1).astype(np.int16)
    return labels[np.maximum(frame.region_of, -1)]
