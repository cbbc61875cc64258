"""What telemetry gets to see of the map: rendered views and the surface."""

from __future__ import annotations

import cv2
import numpy as np

from proground_log.bounds import Bounds
from proground_log.camera import Camera, transform
from proground_log.events import MeshExtracted, SemanticView, SurfaceMeaning, ViewRendered
from proground_log.field.semantic_heads import NO_SUPERVISION
from proground_log.frame import Frame
from proground_log.mapping.map import Map, Meaning, RenderedView
from proground_log.perception.description import PerceptionDescription
from proground_log.query.grounding import relevance_to
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
        perception: what its meaning is of; None where it has none.
    """

    def __init__(
        self, config: TelemetryConfig, bounds: Bounds, perception: PerceptionDescription | None
    ) -> None:
        self._config, self._perception = config, perception
        volume_m3 = float(bounds.size_m.prod())
        # In a house a lattice of the voxel asked for would be too large.
        self._voxel_m = max(config.mesh_voxel_m, (volume_m3 / MOST_LATTICE_POINTS) ** (1 / 3))
        self._colors = SemanticColors(perception) if perception is not None else None

    def view(self, mapped: Map, frame: Frame) -> ViewRendered:
        """The frame's view, as the map and as the sensor has it."""
        width = min(self._config.view_width, frame.camera.width)
        camera = frame.camera.scaled_to_width(width)
        pose = frame.world_from_camera
        rendered = mapped.render(camera, pose, with_meaning=self._perception is not None)
        size = (camera.width, camera.height)
        seen = np.where(frame.color_valid[..., None], frame.color, np.uint8(0))
        meaning = None
        if self._perception is not None:
            told = rendered.meaning or _meaning_of_view(mapped, rendered, camera, pose)
            meaning = self._of_view(told, rendered.depth_m, frame, size)
        return ViewRendered(
            frame_index=frame.index,
            color=cv2.resize(seen, size, interpolation=cv2.INTER_AREA),
            # Depth must not be mixed across edges.
            depth_m=cv2.resize(frame.depth_m, size, interpolation=cv2.INTER_NEAREST),
            rendered_color=rendered.color,
            rendered_depth_m=rendered.depth_m,
            semantics=meaning,
        )

    def mesh(self, mapped: Map, frame_index: int) -> MeshExtracted:
        """The surface so far."""
        mesh = extract_mesh(mapped, self._voxel_m)
        meaning = None
        if self._perception is not None and len(mesh.vertices_m):
            meaning = self._of_surface(mapped.meaning(mesh.vertices_m), self._perception)
        return MeshExtracted(
            frame_index, mesh.vertices_m, mesh.faces, mesh.normals, mesh.colors, meaning
        )

    def _of_view(
        self, meaning: Meaning, depth_m: np.ndarray, frame: Frame, size: tuple[int, int]
    ) -> SemanticView:
        hit = depth_m > 0
        levels, uncertainty = meaning.levels, meaning.uncertainty
        shape = depth_m.shape
        observed = cv2.resize(_observed_labels(frame), size, interpolation=cv2.INTER_NEAREST)
        features = self._features(meaning)
        return SemanticView(
            labels=np.where(hit, meaning.labels.reshape(shape), np.int16(-1)),
            observed_labels=observed,
            features=None if features is None else features.reshape(*shape, 3) * hit[..., None],
            levels=None
            if levels is None
            else np.where(hit, levels.reshape(shape), np.uint8(NO_SUPERVISION)),
            uncertainty=None
            if uncertainty is None
            else np.where(hit, uncertainty.reshape(shape), np.float32(1)),
        )

    def _of_surface(self, meaning: Meaning, perception: PerceptionDescription) -> SurfaceMeaning:
        logits = meaning.logits
        return SurfaceMeaning(
            labels=meaning.labels,
            features=self._features(meaning),
            relevance=relevance_to(logits[:, 0], logits.max(axis=1), meaning.background),
            prompt=perception.task.prompts[0],
        )

    def _features(self, meaning: Meaning) -> np.ndarray | None:
        """The embeddings' colours, uint8 [N, 3], where there are any."""
        if meaning.embeddings is None or self._colors is None:
            return None
        return self._colors(meaning.embeddings)


def _meaning_of_view(
    mapped: Map, rendered: RenderedView, camera: Camera, world_from_camera: np.ndarray
) -> Meaning:
    """What a map says of the surface that a view of it shows, where it does not render that."""
    points_m = transform(world_from_camera, camera.unproject(rendered.depth_m).reshape(-1, 3))
    return mapped.meaning(points_m)


def _observed_labels(frame: Frame) -> np.ndarray:
    """The best prompt of the region at each pixel, -1 for none, int16 [H, W]."""
    if frame.regions is None or frame.region_of is None:
        return np.full(frame.depth_m.shape, -1, np.int16)
    labels = np.append(frame.regions.labels, -1).astype(np.int16)
    return labels[np.maximum(frame.region_of, -1)]
