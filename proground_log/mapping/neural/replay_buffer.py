"""The replay buffer: a bounded, fair memory of what was seen (paper, M^t in Eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from proground_log.frame import Frame
from proground_log.mapping.neural.records import joined, take_rows
from proground_log.mapping.neural.statistics import BufferStatistics
from proground_log.mapping.neural.water_level import below_water_level

EVICTION_SHARE = 0.9
"""Part of the capacity that an eviction leaves: sorting all samples at every keyframe is slow."""


@dataclass(frozen=True)
class RaySamples:
    """Pixels with what was measured there, as rays in the world.

    Args:
        origins_m: float32 [N, 3], where the camera was.
        directions: float32 [N, 3], world axes, of length 1 along the camera's z axis.
        depth_m: float32 [N], measured along z, > 0.
        colors: uint8 [N, 3] RGB.
    """

    origins_m: np.ndarray
    directions: np.ndarray
    depth_m: np.ndarray
    colors: np.ndarray

    def __len__(self) -> int:
        return len(self.depth_m)

    def take(self, rows: np.ndarray) -> RaySamples:
        """The samples of these rows."""
        return take_rows(self, rows)

    def points_m(self) -> np.ndarray:
        """The measured surface points, float32 [N, 3] in the world."""
        return self.origins_m + self.directions * self.depth_m[:, None]

    @staticmethod
    def concatenate(first: RaySamples, second: RaySamples) -> RaySamples:
        """Both, one after the other."""
        return joined(first, second)

    @staticmethod
    def empty() -> RaySamples:
        """No samples."""
        vectors = np.zeros((0, 3), np.float32)
        return RaySamples(vectors, vectors, np.zeros(0, np.float32), np.zeros((0, 3), np.uint8))


def ray_samples(frame: Frame, pixels: np.ndarray) -> RaySamples:
    """The samples at flat pixel numbers [N] of a frame."""
    directions = frame.camera.directions.reshape(-1, 3)[pixels]
    rotation = frame.world_from_camera[:3, :3].astype(np.float32)
    origin_m = frame.world_from_camera[:3, 3].astype(np.float32)
    return RaySamples(
        origins_m=np.broadcast_to(origin_m, directions.shape).copy(),
        directions=directions @ rotation.T,
        depth_m=frame.depth_m.reshape(-1)[pixels],
        colors=frame.color.reshape(-1, 3)[pixels],
    )


class ReplayBuffer:
    """Keeps samples of keyframes, at most `capacity`, and old places as well as new ones.

    Space is cut into cells, the places. While all samples fit, all stay. When they do not, the
    most crowded places give way: each place keeps at most as many samples as a common water level
    allows, those of the lowest random rank. A place that the camera left long ago, or saw only
    for a moment, so keeps what it has while one that it stares at is thinned, and within a place
    every sample ever inserted has had the same chance.

    Args:
        capacity: most samples held.
        place_m: side of a cell in metres.
    """

    def __init__(self, capacity: int, place_m: float) -> None:
        self._capacity, self._place_m = capacity, place_m
        self._rays = RaySamples.empty()
        self._places = np.zeros(0, np.int64)
        self._ranks = np.zeros(0, np.uint32)
        self._keyframes = np.zeros(0, np.int32)

    def __len__(self) -> int:
        return len(self._ranks)

    def insert(self, keyframe: int, rays: RaySamples, random: np.random.Generator) -> int:
        """Add a keyframe's samples.

        Args:
            keyframe: number of its frame in the log.
            rays: its samples.
            random: draws their ranks.

        Returns:
            How many samples, old or new, had to go.
        """
        ranks = random.integers(0, 2**32, size=len(rays), dtype=np.uint32)
        keyframes = np.full(len(rays), keyframe, np.int32)
        self._rays = RaySamples.concatenate(self._rays, rays)
        self._places = np.concatenate([self._places, self._places_of(rays)])
        self._ranks = np.concatenate([self._ranks, ranks])
        self._keyframes = np.concatenate([self._keyframes, keyframes])
        before = len(self)
        if before > self._capacity:
            most = round(EVICTION_SHARE * self._capacity)
            self._keep(below_water_level(self._places, self._ranks, most))
        return before - len(self)

    def _places_of(self, rays: RaySamples) -> np.ndarray:
        """The cell of each sample's surface point as one number, int64 [N]."""
        cells = np.floor(rays.points_m() / np.float32(self._place_m)).astype(np.int64)
        return (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]

    def _keep(self, rows: np.ndarray) -> None:
        self._rays = self._rays.take(rows)
        self._places, self._ranks = self._places[rows], self._ranks[rows]
        self._keyframes = self._keyframes[rows]

    def take(self, rows: np.ndarray) -> RaySamples:
        """The samples of these rows."""
        return self._rays.take(rows)

    def statistics(self) -> BufferStatistics:
        """Figures for telemetry."""
        _, counts = np.unique(self._places, return_counts=True)
        return BufferStatistics(
            samples=len(self),
            capacity=self._capacity,
            keyframes=len(np.unique(self._keyframes)),
            places=len(counts),
            water_level=int(counts.max(initial=0)),
            size_bytes=sum(array.nbytes for array in self.state().values()),
        )

    def state(self) -> dict[str, np.ndarray]:
        """All that is held, by name."""
        rays = {f.name: getattr(self._rays, f.name) for f in fields(RaySamples)}
        return {
            **rays,
            "places": self._places,
            "ranks": self._ranks,
            "keyframes": self._keyframes,
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned."""
        self._rays = RaySamples(*(state[f.name] for f in fields(RaySamples)))
        self._places, self._ranks = state["places"], state["ranks"]
        self._keyframes = state["keyframes"]
