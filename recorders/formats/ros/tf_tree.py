"""ROS's transforms between coordinate frames: a tree, some of whose edges change with time."""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from proground_log.camera import pose_from_quaternion
from proground_log.errors import ProgroundError
from recorders.reading.association import UNIT_TOLERANCE, Trajectory


@dataclass(frozen=True, eq=False)
class Edge:
    """Where a frame sits in its parent: `pose` [4, 4] at all times, or a trajectory."""

    parent: str
    child: str
    pose: np.ndarray | None
    trajectory: Trajectory | None = None

    def covers(self, stamps_ns: Sequence[int]) -> np.ndarray:
        """Whether parent_from_child is known at each time, bool [M]."""
        if self.trajectory is None:
            return np.ones(len(stamps_ns), dtype=bool)
        return self.trajectory.covers(stamps_ns)

    def at(self, stamps_ns: Sequence[int]) -> np.ndarray:
        """parent_from_child at each time, float64 [M, 4, 4]; all of them have to be covered."""
        if self.trajectory is None:
            return np.repeat(np.asarray(self.pose)[None], len(stamps_ns), axis=0)
        return self.trajectory.at(stamps_ns)


@dataclass
class Transforms:
    """Gathers transforms as a bag has them, in some 64 bytes each.

    As tf2 does, it leaves out (and counts in `left_out`) those that are not finite, whose
    quaternion is not of norm 1, or that lead from a frame to itself.
    """

    left_out: int = 0
    _moving: dict[tuple[str, str], tuple[array[int], array[float]]] = field(default_factory=dict)
    _fixed: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)

    def add(
        self, parent: str, child: str, stamp_ns: int, pose: Any, *, is_static: bool = False
    ) -> None:
        """Add a transform.

        Args:
            parent, child: names of the frames; ROS 1 may have a slash before them.
            stamp_ns: its time.
            pose: a Transform or a Pose of geometry_msgs, parent_from_child.
            is_static: whether it holds at all times.
        """
        names = parent.removeprefix("/"), child.removeprefix("/")
        is_transform = hasattr(pose, "translation")
        position = pose.translation if is_transform else pose.position
        turn = pose.rotation if is_transform else pose.orientation
        numbers = (position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w)
        norm = np.linalg.norm(numbers[3:])
        is_sound = np.isfinite(numbers).all() and abs(norm - 1) <= UNIT_TOLERANCE
        if not is_sound or not all(names) or names[0] == names[1]:
            self.left_out += 1
        elif is_static:
            self._fixed[names] = pose_from_quaternion(np.array(numbers[:3]), np.array(numbers[3:]))
        else:
            stamps_ns, rows = self._moving.setdefault(names, (array("q"), array("d")))
            stamps_ns.append(stamp_ns)
            rows.extend(numbers)

    def edges(self, max_gap_ns: int, *, where: str) -> list[Edge]:
        """An edge for each pair of frames, sorted by name.

        A transform that was sent more than once and always alike is static: before /tf_static,
        mounts were sent on /tf again and again.

        Args:
            max_gap_ns: two transforms further apart are not interpolated between.
            where: the bag, for messages.
        """
        edges = [Edge(*names, pose) for names, pose in self._fixed.items()]
        for names, (stamps, numbers) in self._moving.items():
            if names in self._fixed:
                continue
            rows = np.array(numbers).reshape(-1, 7)
            # Of two at the same time the first one counts, as in tf2.
            stamps_ns, chosen = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
            if len(rows) > 1 and (rows == rows[0]).all():
                edges.append(Edge(*names, pose_from_quaternion(rows[0, :3], rows[0, 3:])))
                continue
            rows = rows[chosen]
            trajectory = Trajectory(
                stamps_ns, rows[:, :3], rows[:, 3:], max_gap_ns, f"{where}, {' -> '.join(names)}"
            )
            edges.append(Edge(*names, None, trajectory))
        return sorted(edges, key=lambda edge: (edge.parent, edge.child))


@dataclass(frozen=True)
class TfPath:
    """The way between two frames: edges from the source on, and whether each goes to its parent."""

    steps: tuple[tuple[Edge, bool], ...]

    @property
    def is_static(self) -> bool:
        """Whether nothing on the way changes with time."""
        return all(edge.trajectory is None for edge, _ in self.steps)

    def covers(self, stamps_ns: Sequence[int]) -> np.ndarray:
        """Whether the transform is known at each time, bool [M]."""
        known = np.ones(len(stamps_ns), dtype=bool)
        for edge, _ in self.steps:
            known &= edge.covers(stamps_ns)
        return known

    def at(self, stamps_ns: Sequence[int]) -> np.ndarray:
        """target_from_source at each time, float64 [M, 4, 4]; each time has to be covered."""
        poses = np.repeat(np.eye(4)[None], len(stamps_ns), axis=0)
        for edge, goes_up in self.steps:
            step = edge.at(stamps_ns)
            poses = (step if goes_up else np.linalg.inv(step)) @ poses
        return poses


class TfTree:
    """Coordinate frames and the edges between them.

    Args:
        edges: in any order; where frames have several parents, the shortest way counts.
        where: the bag, for messages.
    """

    def __init__(self, edges: Iterable[Edge], *, where: object) -> None:
        self._edges, self._where = list(edges), where
        self._steps: dict[str, list[tuple[str, Edge, bool]]] = defaultdict(list)
        for edge in self._edges:
            self._steps[edge.child].append((edge.parent, edge, True))
            self._steps[edge.parent].append((edge.child, edge, False))

    def placed(self, edge: Edge) -> TfTree:
        """The tree with this edge in place of those from its child to parents."""
        others = [other for other in self._edges if other.child != edge.child]
        return TfTree([*others, edge], where=self._where)

    def root_above(self, frame: str) -> str:
        """The frame without a parent that is connected to this one.

        Raises:
            ProgroundError: there are several.
        """
        children = {edge.child for edge in self._edges}
        roots = sorted(self._ways(frame).keys() - children) or [frame]
        if len(roots) > 1:
            raise ProgroundError(
                f"the frame {frame!r} hangs from several ({', '.join(roots)})",
                where=self._where,
                todo="choose one with world_frame",
            )
        return roots[0]

    def connects(self, target: str, source: str) -> bool:
        """Whether there is a way between two frames."""
        return target in self._ways(source)

    def path(self, target: str, source: str) -> TfPath:
        """The way from one frame to another.

        Raises:
            ProgroundError: there is none; names the frames that there are.
        """
        ways = self._ways(source)
        if target not in ways:
            frames = ", ".join(sorted(self._steps)) or "none at all"
            raise ProgroundError(
                f"no transforms lead from the frame {source!r} to {target!r}",
                where=self._where,
                todo=f"record /tf and /tf_static whole, or choose another; its frames: {frames}",
            )
        return TfPath(ways[target])

    def _ways(self, source: str) -> dict[str, tuple[tuple[Edge, bool], ...]]:
        """The shortest way from a frame to each that it is connected to."""
        ways: dict[str, tuple[tuple[Edge, bool], ...]] = {source: ()}
        waiting = deque([source])
        while waiting:
            frame = waiting.popleft()
            for neighbour, edge, goes_up in self._steps.get(frame, ()):
                if neighbour not in ways:
                    ways[neighbour] = (*ways[frame], (edge, goes_up))
                    waiting.append(neighbour)
        return ways
