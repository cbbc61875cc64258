"""A mapper of one's own: the mean colour, normal and region of each voxel, drawn as points."""

from dataclasses import dataclass

import numpy as np

from proground_log.mapping.kinds import MapperKind
from proground_log.mapping.points.drawing import frame_points
from proground_log.mapping.points.point_map import PointMap, load_point_map
from proground_log.mapping.points.voxel_means import VoxelMeans


@dataclass(frozen=True)
class PointsConfig:
    voxel_m: float = 0.04
    """Side of a voxel."""
    stride: int = 2
    """Every so many-th pixel each way is looked at."""


class PointsMapper:
    def __init__(self, settings, *, bounds, seed, device, perception):
        self.settings, self.bounds, self.description = settings, bounds, perception
        self.surface = VoxelMeans(bounds, settings.voxel_m, columns=9)
        self.regions = VoxelMeans(bounds, settings.voxel_m, columns=516)

    def insert(self, frame, *, is_keyframe):
        points_m, pixels = frame_points(frame, self.settings.stride)
        towards = frame.world_from_camera[:3, 3] - points_m
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        colors = frame.color.reshape(-1, 3)[pixels]
        self.surface.add(points_m, np.concatenate([points_m, colors, towards], axis=1))
        self.insert_regions(frame)
        return ()

    def insert_regions(self, frame):
        if self.description is None or frame.regions is None:
            return
        points_m, pixels = frame_points(frame, self.settings.stride)
        owner = frame.region_of.reshape(-1)[pixels]
        points_m, owner = points_m[owner >= 0], owner[owner >= 0]
        regions = frame.regions
        rows = self.description.heads.in_text_space(regions.embeddings, regions.levels)[owner]
        rows = np.concatenate([points_m, rows], axis=1)
        self.regions.add(points_m, rows, regions.confidence[owner])

    def counts(self):
        return {"points": {"voxels": len(self.surface), "with_regions": len(self.regions)}}

    def state(self):
        parts = {"surface": self.surface, "regions": self.regions}
        return {f"{p}/{n}": a for p, means in parts.items() for n, a in means.state().items()}

    def restore(self, state):
        for part in ("surface", "regions"):
            names = ("keys", "sums", "counts")
            getattr(self, part).restore({name: state[f"{part}/{name}"] for name in names})

    def map(self):
        points_m, colors, normals = np.split(self.surface.means(), [3, 6], axis=1)
        meaning_m, features = np.split(self.regions.means(), [3], axis=1)
        rgb = colors.round().astype(np.uint8)
        whole = points_m, rgb, normals, meaning_m, features
        voxel_m = self.settings.voxel_m
        return PointMap("points", self.bounds, self.description, voxel_m, *whole)

    def steps(self, count):
        return []

    def scores(self, frame_index):
        return None

    def finish(self):
        pass


KIND = MapperKind(PointsConfig, PointsMapper, load_point_map, learns=lambda settings: True)
