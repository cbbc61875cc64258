"""Rendering a whole view of the field, with no depth to guide it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from proground_log.camera import Camera
from proground_log.field.config import SemanticSpace
from proground_log.field.neural_field import NeuralField
from proground_log.field.rendering import before_surface, composite, sdf_weights
from proground_log.field.semantic_heads import PointFeatures

MARCH_FRACTION = 0.8
"""Part of the distance to the surface, as the field has it, that a march dares to go."""
SHORTEST_STEP = 0.1
"""Shortest step of a march, in truncations."""
LOST_STEP = 0.5
"""The same for a ray that met nothing that was seen: what it may yet meet is a guess anyway."""
MOST_STEPS = 200
SURFACE_SAMPLES = 16
"""Samples on each ray around the surface that the march found."""
RAYS_AT_ONCE = 4096
COLOR_EDGE, DEPTH_EDGE = 0.08, 0.03
"""Neighbours that differ by more, in colour or as a share of depth, have an edge between them."""
QUARTERS = (-0.25, 0.25)


class EmptySpace:
    """How far each voxel is from any surface that was seen, so that a march can leap.

    Args:
        distance_m: float32 [X, Y, Z], distance from any point of a voxel to the nearest seen
            surface, or less.
        lower_m: the lattice's lower corner, [3].
        voxel_m: side of a voxel.
        device: where to keep it.
    """

    def __init__(
        self, distance_m: np.ndarray, lower_m: np.ndarray, voxel_m: float, device: torch.device
    ) -> None:
        self._distance_m = torch.from_numpy(distance_m.reshape(-1)).to(device)
        self._lower_m = torch.from_numpy(lower_m.astype(np.float32)).to(device)
        self._voxel_m = voxel_m
        self._most = torch.tensor(distance_m.shape, device=device) - 1
        self._strides = torch.tensor(
            [distance_m.shape[1] * distance_m.shape[2], distance_m.shape[2], 1], device=device
        )

    def leap_m(self, points_m: Tensor) -> Tensor:
        """How far from points [N, 3] in metres there is certainly nothing, [N]."""
        cells = ((points_m - self._lower_m) / self._voxel_m).long()
        cells = torch.minimum(cells.clamp_min(0), self._most)
        return self._distance_m[(cells * self._strides).sum(dim=1)]


@torch.no_grad()
def render_view(
    field: NeuralField,
    empty: EmptySpace,
    camera: Camera,
    world_from_camera: np.ndarray,
    *,
    near_m: float,
    space: SemanticSpace | None = None,
    antialias: bool = False,
) -> tuple[np.ndarray, np.ndarray, PointFeatures | None]:
    """Render colour, depth and semantic features as the camera would see the map.

    Each ray marches through the signed distances to the first change of sign and is then
    rendered (Eq. 4) from samples one truncation to either side of it. Space that is known to be
    far from any seen surface is leapt over; a ray that finds nothing that way, because it looks
    at what was never seen, marches again without leaping.

    Args:
        field: the map's field.
        empty: where nothing was seen.
        camera: its pinhole camera; the size of the result.
        world_from_camera: pose, float64 [4, 4].
        near_m: where the rays begin, in metres along z.
        space: what semantics are decoded from; None renders no features.
        antialias: colour the pixels at edges as the mean of four rays; depth stays that of one.

    Returns:
        Colour, uint8 [H, W, 3] RGB; depth, float32 [H, W] along z in metres, both 0 where a ray
        meets no surface; and in a space what semantic heads look at, [H * W, ...].
    """
    device = field.table.device
    rotation = world_from_camera[:3, :3].astype(np.float32)
    directions = torch.from_numpy(camera.directions.reshape(-1, 3) @ rotation.T).to(device)
    origin_m = torch.from_numpy(world_from_camera[:3, 3].astype(np.float32)).to(device)
    parts = [
        _render_rays(field, empty, origin_m, part, near_m, space)
        for part in directions.split(RAYS_AT_ONCE)
    ]
    colors, depths_m, features = zip(*parts, strict=True)
    color, depth_m = torch.cat(colors), torch.cat(depths_m)
    if antialias:
        rough = _at_edges(color.reshape(camera.height, camera.width, 3), depth_m)
        color[rough] = _mean_of_four(
            field, empty, origin_m, directions[rough], camera, rotation, near_m
        )
    image = (color * 255).round().to(torch.uint8)
    return (
        image.reshape(camera.height, camera.width, 3).cpu().numpy(),
        depth_m.reshape(camera.height, camera.width).cpu().numpy(),
        PointFeatures.concatenate(features) if space is not None else None,
    )


def _at_edges(color: Tensor, depth_m: Tensor) -> Tensor:
    """Flat numbers of pixels that differ from a neighbour in colour [H, W, 3] or depth [H * W]."""
    planes = torch.cat(
        [color / COLOR_EDGE, depth_m.reshape(*color.shape[:2], 1).log1p() / DEPTH_EDGE], 2
    )
    planes = planes.permute(2, 0, 1)[:, None]
    most = nn.functional.max_pool2d(planes, 3, 1, 1)
    least = -nn.functional.max_pool2d(-planes, 3, 1, 1)
    return ((most - least).amax(dim=(0, 1)) > 1).reshape(-1).nonzero()[:, 0]


def _mean_of_four(
    field: NeuralField,
    empty: EmptySpace,
    origin_m: Tensor,
    directions: Tensor,
    camera: Camera,
    rotation: np.ndarray,
    near_m: float,
) -> Tensor:
    """Mean colour [R, 3] of four rays, a quarter of a pixel around each of the rays given."""
    steps = np.array([[x / camera.fx, y / camera.fy, 0] for x in QUARTERS for y in QUARTERS])
    around = torch.from_numpy((steps @ rotation.T).astype(np.float32)).to(directions.device)
    total, hits = torch.zeros_like(directions), torch.zeros_like(directions[:, :1])
    for offset in around:
        parts = [
            _render_rays(field, empty, origin_m, part, near_m, None)[:2]
            for part in (directions + offset).split(RAYS_AT_ONCE)
        ]
        total += torch.cat([colors for colors, _ in parts])
        hits += (torch.cat([depth_m for _, depth_m in parts]) > 0)[:, None]
    return total / hits.clamp_min(1)


def _render_rays(
    field: NeuralField,
    empty: EmptySpace,
    origin_m: Tensor,
    directions: Tensor,
    near_m: float,
    space: SemanticSpace | None,
) -> tuple[Tensor, Tensor, PointFeatures | None]:
    """Colour [R, 3], depth [R] and, in a space, features [R, ...] of the rays from one origin."""
    surface_m = _march(field, empty, origin_m, directions, near_m, SHORTEST_STEP)
    lost = surface_m.isinf().nonzero()[:, 0]
    surface_m[lost] = _march(field, None, origin_m, directions[lost], near_m, LOST_STEP)
    found = surface_m.isfinite()
    tr_m = field.config.truncation_m
    spread_m = torch.linspace(-tr_m, tr_m, SURFACE_SAMPLES, device=directions.device)
    z_m = (surface_m.where(found, 0.0)[:, None] + spread_m).clamp_min(near_m)
    points_m = origin_m + directions[:, None] * z_m[..., None]
    points, inside = field.normalise(points_m.reshape(-1, 3))
    features = None
    if space is None:
        sdf, color = field(points)
    else:
        sdf, color, features = field.with_features(points, space)
    sdf = sdf.reshape(z_m.shape)
    counts = inside.reshape(z_m.shape) & before_surface(sdf, z_m, tr_m) & found[:, None]
    weights = sdf_weights(sdf, counts)
    colors = composite(weights, color.reshape(*z_m.shape, 3))
    depths_m = (weights * z_m).sum(dim=1)
    return colors, depths_m, features.rendered(weights) if features is not None else None


def _march(
    field: NeuralField,
    empty: EmptySpace | None,
    origin_m: Tensor,
    directions: Tensor,
    near_m: float,
    shortest_step: float,
) -> Tensor:
    """Depth in metres of the first change of sign along each ray [R]; infinite where none is."""
    tr_m = field.config.truncation_m
    near, far = _span(field, origin_m, directions, near_m)
    length = directions.norm(dim=1)
    surface_m = torch.full_like(near, torch.inf)
    active = (near < far).nonzero()[:, 0]
    z_m = near[active]
    previous_m, previous_sdf = z_m, torch.ones_like(z_m)
    for _ in range(MOST_STEPS):
        if not len(active):
            break
        points_m = origin_m + directions[active] * z_m[:, None]
        sdf = torch.ones_like(z_m)
        step_m = torch.zeros_like(z_m)
        if empty is not None:
            step_m = empty.leap_m(points_m) / length[active]
        close = (step_m <= tr_m).nonzero()[:, 0]
        points, _ = field.normalise(points_m[close])
        sdf[close] = field.sdf(points)
        step_m[close] = (sdf[close] * MARCH_FRACTION).clamp(shortest_step, 1.0) * tr_m
        crossed = sdf <= 0
        # Between the last sample outside and the first inside, the distance is taken as linear.
        share = previous_sdf / (previous_sdf - sdf).clamp_min(1e-6)
        crossing_m = previous_m + (z_m - previous_m) * share
        surface_m[active[crossed]] = crossing_m[crossed]
        z_next_m = z_m + step_m
        going = ~crossed & (z_next_m < far[active])
        active, previous_m, previous_sdf = active[going], z_m[going], sdf[going]
        z_m = z_next_m[going]
    return surface_m


def _span(
    field: NeuralField, origin_m: Tensor, directions: Tensor, near_m: float
) -> tuple[Tensor, Tensor]:
    """Where along z each ray enters and leaves the bounds, [R] each, in metres."""
    safe = torch.where(directions.abs() < 1e-9, torch.full_like(directions, 1e-9), directions)
    first = (field.lower_m - origin_m) / safe
    second = (field.lower_m + field.size_m - origin_m) / safe
    near = torch.minimum(first, second).amax(dim=1).clamp_min(near_m)
    return near, torch.maximum(first, second).amin(dim=1)
