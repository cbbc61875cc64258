"""The memory of meaning: rays that hit a region, each region's embedding held once (paper 4.3)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from proground_log.mapping.neural.records import joined, take_rows
from proground_log.mapping.neural.water_level import below_water_level
from proground_log.regions import EMBEDDING_WIDTH, LEVELS, Regions

EVICTION_SHARE = 0.9
"""Part of the capacity that an eviction leaves, so that not every keyframe needs one."""
MOST_REGIONS = 20_000
"""Regions remembered; their embeddings take 20 MB."""


@dataclass(frozen=True)
class RegionTable:
    """What is known of regions, a row each.

    Args:
        embeddings: float16 [M, 512].
        confidence: float32 [M], relevance to the best prompt (c_tau).
        levels: uint8 [M], 0 to 2.
        labels: int32 [M], number of the best prompt.
    """

    embeddings: np.ndarray
    confidence: np.ndarray
    levels: np.ndarray
    labels: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def groups(self) -> np.ndarray:
        """Label and level as one number, int64 [M]."""
        return self.labels.astype(np.int64) * LEVELS + self.levels

    def take(self, rows: np.ndarray) -> RegionTable:
        """These rows."""
        return take_rows(self, rows)

    @staticmethod
    def of(regions: Regions) -> RegionTable:
        """The regions of an image."""
        return RegionTable(
            regions.embeddings,
            regions.confidence.astype(np.float32),
            regions.levels,
            regions.labels.astype(np.int32),
        )

    @staticmethod
    def concatenate(first: RegionTable, second: RegionTable) -> RegionTable:
        """Both, one after the other."""
        return joined(first, second)

    @staticmethod
    def empty() -> RegionTable:
        """No region."""
        return RegionTable(
            np.zeros((0, EMBEDDING_WIDTH), np.float16),
            np.zeros(0, np.float32),
            np.zeros(0, np.uint8),
            np.zeros(0, np.int32),
        )


@dataclass(frozen=True)
class SemanticRays:
    """Rays that hit a region.

    Args:
        origins_m: float32 [N, 3], where the camera was.
        directions: float32 [N, 3], world axes, of length 1 along the camera's z axis.
        depth_m: float32 [N], measured along z, > 0.
        regions: int32 [N], row of each ray's region in the table that comes with them.
    """

    origins_m: np.ndarray
    directions: np.ndarray
    depth_m: np.ndarray
    regions: np.ndarray

    def __len__(self) -> int:
        return len(self.depth_m)

    def take(self, rows: np.ndarray) -> SemanticRays:
        """The rays of these rows."""
        return take_rows(self, rows)

    @staticmethod
    def concatenate(first: SemanticRays, second: SemanticRays) -> SemanticRays:
        """Both, one after the other; of one table."""
        return joined(first, second)

    @staticmethod
    def empty() -> SemanticRays:
        """No ray."""
        vectors = np.zeros((0, 3), np.float32)
        return SemanticRays(vectors, vectors, np.zeros(0, np.float32), np.zeros(0, np.int32))


class SemanticBuffer:
    """Keeps at most `capacity` semantic rays, shared out among labels and pyramid levels.

    Every pair of label and level keeps at most as many rays as a common water level allows: a
    rare object is not pushed out by a wall of chairs. Regions that no ray belongs to any more are
    forgotten with their embedding, so that memory stays flat on a long log.

    Args:
        capacity: most rays held.
        balance: how pairs of label and level are drawn, as count ** balance: 1 draws every ray
            alike, 0 every pair.
    """

    def __init__(self, capacity: int, balance: float) -> None:
        self._capacity, self._balance = capacity, balance
        self._rays = SemanticRays.empty()
        self._ranks = np.zeros(0, np.uint32)
        self.table = RegionTable.empty()
        self._arrange()

    def __len__(self) -> int:
        return len(self._rays)

    def insert(self, rays: SemanticRays, table: RegionTable, random: np.random.Generator) -> int:
        """Add rays and the regions they belong to; returns how many, old or new, had to go."""
        shifted = np.int32(len(self.table)) + rays.regions
        moved = SemanticRays(rays.origins_m, rays.directions, rays.depth_m, shifted)
        ranks = random.integers(0, 2**32, size=len(rays), dtype=np.uint32)
        self._rays = SemanticRays.concatenate(self._rays, moved)
        self._ranks = np.concatenate([self._ranks, ranks])
        self.table = RegionTable.concatenate(self.table, table)
        before = len(self)
        if before > self._capacity:
            groups = self.table.groups[self._rays.regions]
            kept = below_water_level(groups, self._ranks, round(EVICTION_SHARE * self._capacity))
            self._rays, self._ranks = self._rays.take(kept), self._ranks[kept]
        self._make_room_for_regions()
        self._forget_unused_regions()
        self._arrange()
        return before - len(self)

    def _make_room_for_regions(self) -> None:
        """Give up regions, those of crowded pairs first, when there are too many of them."""
        present = np.flatnonzero(np.bincount(self._rays.regions))
        if len(present) <= MOST_REGIONS:
            return
        lowest = np.full(len(self.table), np.iinfo(np.uint32).max, np.uint32)
        np.minimum.at(lowest, self._rays.regions, self._ranks)
        most = round(EVICTION_SHARE * MOST_REGIONS)
        kept = present[below_water_level(self.table.groups[present], lowest[present], most)]
        rows = np.flatnonzero(np.isin(self._rays.regions, kept))
        self._rays, self._ranks = self._rays.take(rows), self._ranks[rows]

    def _forget_unused_regions(self) -> None:
        used = np.flatnonzero(np.bincount(self._rays.regions))
        row_of = np.zeros(len(self.table), np.int32)
        row_of[used] = np.arange(len(used), dtype=np.int32)
        rays = self._rays
        self._rays = SemanticRays(
            rays.origins_m, rays.directions, rays.depth_m, row_of[rays.regions]
        )
        self.table = self.table.take(used)

    def _arrange(self) -> None:
        """Prepare drawing: the rows in order of their group, and each group's weight."""
        groups = self.table.groups[self._rays.regions]
        counts = np.bincount(groups)
        # Numbers of 16 bits are sorted by radix, many times faster; there are seldom more groups.
        narrow = groups.astype(np.uint16) if len(counts) <= 2**16 else groups
        self._order = np.argsort(narrow, kind="stable")
        self._groups = np.flatnonzero(counts)
        self._counts = counts[self._groups]
        self._starts = np.cumsum(self._counts) - self._counts
        self._cumulative = np.cumsum(self._counts.astype(np.float64) ** self._balance)

    def draw(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Row numbers of `count` rays, int64, with replacement; the buffer must not be empty."""
        at = random.random(count) * self._cumulative[-1]
        last = len(self._groups) - 1
        group = np.minimum(np.searchsorted(self._cumulative, at, side="right"), last)
        within = (random.random(count) * self._counts[group]).astype(np.int64)
        return self._order[self._starts[group] + within]

    def take(self, rows: np.ndarray) -> SemanticRays:
        """The rays of these rows; their regions are rows of `table`."""
        return self._rays.take(rows)

    def counts(self) -> tuple[np.ndarray, np.ndarray]:
        """Rays held by label, int64 [labels], and by level, int64 [3]."""
        regions = self._rays.regions
        return (
            np.bincount(self.table.labels[regions]),
            np.bincount(self.table.levels[regions], minlength=LEVELS),
        )

    def state(self) -> dict[str, np.ndarray]:
        """All that is held, by name."""
        rays = {f.name: getattr(self._rays, f.name) for f in fields(SemanticRays)}
        table = {f"table/{f.name}": getattr(self.table, f.name) for f in fields(RegionTable)}
        return {**rays, **table, "ranks": self._ranks}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned."""
        self._rays = SemanticRays(*(state[f.name] for f in fields(SemanticRays)))
        self.table = RegionTable(*(state[f"table/{f.name}"] for f in fields(RegionTable)))
        self._ranks = state["ranks"]
        self._arrange()
