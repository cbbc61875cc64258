"""Times and poses in text files: exact stamps, one-to-one association, interpolated poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from proground_log.camera import require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import require_file

SECOND_NS = 1_000_000_000
LARGEST_STAMP_NS = 2**63 - 1
LONGEST_SPAN_S = 1e9
UNIT_TOLERANCE = 1e-2
"""How far a quaternion's norm may be from 1: some files carry three digits."""


def read_text(path: Path) -> str:
    """The text of a file; raises a ProgroundError where it is missing or is not text."""
    try:
        # Editors on Windows put a byte order mark first, which is not of the text.
        return require_file(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ProgroundError("is not a text file", where=path, todo="check the path") from error


def parse_stamp_ns(text: str, *, where: object) -> int:
    """Nanoseconds of a number of seconds in decimal notation, exact, never through a float.

    Digits beyond the ninth decimal are rounded, half to even.

    Raises:
        ProgroundError: the text is not a finite number of seconds that fits in 64 bits.

    >>> parse_stamp_ns("1305031229.528784", where="rgb.txt")
    1305031229528784000
    """
    try:
        seconds = Decimal(text)
        is_time = abs(seconds) <= LARGEST_STAMP_NS // SECOND_NS
    except ArithmeticError:  # No number, or one with too large an exponent.
        is_time = False
    if not is_time:
        raise ProgroundError(
            f"{text!r} is not a time in seconds", where=where, todo="mend or remove the line"
        )
    return int((seconds * SECOND_NS).to_integral_value())


def span_ns(seconds: float, *, name: str) -> int:
    """Nanoseconds of a length of time that the user chose.

    Args:
        seconds: how long.
        name: the option's name, for messages.

    Raises:
        ProgroundError: it is no number from 0 to 1e9 seconds, some 30 years.

    >>> span_ns(0.02, name="--max-time-difference-s")
    20000000
    """
    if not 0 <= seconds <= LONGEST_SPAN_S:
        todo = f"choose seconds from 0 to {LONGEST_SPAN_S:g}"
        raise ProgroundError(f"{seconds} s is no length of time", where=name, todo=todo)
    return round(seconds * SECOND_NS)


def frame_stamp_ns(number: int, rate_hz: int) -> int:
    """Time of frame `number` of a source that has a frame rate and no clock, rounded down.

    >>> frame_stamp_ns(2, rate_hz=30)
    66666666
    """
    return number * SECOND_NS // rate_hz


def parse_pose(text: str, *, where: object) -> np.ndarray:
    """The rigid 4x4 matrix, float64, of 16 numbers in text, row by row.

    Raises:
        ProgroundError: other than 16 numbers, numbers that are not finite, or not rigid.
    """
    return require_rigid(parse_matrix(text, where=where), where=where)


def parse_matrix(text: str, *, where: object) -> np.ndarray:
    """The 4x4 matrix, float64, of 16 numbers in text, row by row; they may be inf or nan.

    Raises:
        ProgroundError: other than 16 numbers.
    """
    try:
        numbers = np.array(text.split(), dtype=np.float64)
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != 16:
        raise ProgroundError(
            "is not a pose of 16 numbers",
            where=where,
            todo="leave the frame out, or mend its pose in the source",
        )
    return numbers.reshape(4, 4)


def is_tracked(world_from_camera: np.ndarray) -> bool:
    """Whether a frame has a pose [4, 4]: where tracking was lost it is -inf, nan or all zero."""
    return bool(np.isfinite(world_from_camera).all() and world_from_camera.any())


def associate(
    first_ns: Sequence[int], second_ns: Sequence[int], max_difference_ns: int
) -> list[tuple[int, int]]:
    """Pair two lists of stamps one to one, the closest pair first (as TUM's `associate.py`).

    Of equally close pairs the earlier one goes first, so that the result depends neither on the
    order of the lists nor on which is called first.

    Args:
        first_ns, second_ns: stamps in any order.
        max_difference_ns: the largest difference within a pair, inclusive.

    Returns:
        Pairs of indices (into first_ns, into second_ns), in the order of the first's stamps.

    >>> associate([0, 100, 200], [90, 195, 230], max_difference_ns=20)
    [(1, 0), (2, 1)]
    """
    first, second = np.asarray(first_ns, dtype=np.int64), np.asarray(second_ns, dtype=np.int64)
    order = np.argsort(second, kind="stable")
    low = np.searchsorted(second[order], first - max_difference_ns, side="left")
    high = np.searchsorted(second[order], first + max_difference_ns, side="right")
    candidates = sorted(
        (abs(int(a - b)), int(min(a, b)), i, int(j))
        for i, a in enumerate(first)
        for j, b in ((j, second[j]) for j in order[low[i] : high[i]])
    )
    free_first, free_second = set(range(len(first))), set(range(len(second)))
    pairs = []
    for _, _, i, j in candidates:
        if i in free_first and j in free_second:
            free_first.remove(i)
            free_second.remove(j)
            pairs.append((i, j))
    return sorted(pairs, key=lambda pair: (first[pair[0]], second[pair[1]], pair))


@dataclass(frozen=True)
class Trajectory:
    """Timed poses to interpolate between.

    Args:
        stamps_ns: strictly ascending, int64 [N].
        positions_m: float64 [N, 3].
        quaternions_xyzw: float64 [N, 4], of norm 1.
        max_gap_ns: two poses further apart than this are not interpolated between.
        where: the file that the poses come from, for messages.
    """

    stamps_ns: np.ndarray
    positions_m: np.ndarray
    quaternions_xyzw: np.ndarray
    max_gap_ns: int
    where: str

    def __post_init__(self) -> None:
        todo = "mend or remove the line"
        numbers = np.concatenate([self.positions_m, self.quaternions_xyzw], axis=1)
        norms = np.linalg.norm(self.quaternions_xyzw, axis=1)
        for what, bad in (
            ("the pose has numbers that are not finite", ~np.isfinite(numbers).all(axis=1)),
            ("the pose's quaternion is not of norm 1", np.abs(norms - 1) > UNIT_TOLERANCE),
            ("another pose has the same time", np.diff(self.stamps_ns, prepend=-1) == 0),
        ):
            if bad.any():
                seconds = Decimal(int(self.stamps_ns[bad][0])) / SECOND_NS
                raise ProgroundError(f"{what} (at {seconds} s)", where=self.where, todo=todo)

    def covers(self, stamps_ns: Sequence[int]) -> np.ndarray:
        """Whether each time has a pose, or one before and one after, close enough; bool [M]."""
        before, after = self._around(stamps_ns)
        inside = (before >= 0) & (after < len(self.stamps_ns))
        covered = np.zeros(len(inside), dtype=bool)
        gaps_ns = self.stamps_ns[after[inside]] - self.stamps_ns[before[inside]]
        covered[inside] = gaps_ns <= self.max_gap_ns
        return covered

    def at(self, stamps_ns: Sequence[int]) -> np.ndarray:
        """Poses [M, 4, 4], float64: linear in position, slerp in rotation, never extrapolated.

        Raises:
            ProgroundError: the trajectory does not cover one of the times.
        """
        for stamp_ns in np.asarray(stamps_ns, dtype=np.int64)[~self.covers(stamps_ns)]:
            raise ProgroundError(
                f"there is no pose at {Decimal(int(stamp_ns)) / SECOND_NS} s, nor two within "
                f"{Decimal(self.max_gap_ns) / SECOND_NS} s to interpolate between",
                where=self.where,
                todo="leave the frame out",
            )
        before, after = self._around(stamps_ns)
        # Differences of integers first: as floats, stamps of 19 digits would lose some.
        start_ns = self.stamps_ns[before]
        span_ns = np.maximum(self.stamps_ns[after] - start_ns, 1)
        fraction = ((np.asarray(stamps_ns, dtype=np.int64) - start_ns) / span_ns)[:, None]
        start, end = (Rotation.from_quat(self.quaternions_xyzw[each]) for each in (before, after))
        turn = Rotation.from_rotvec(fraction * (start.inv() * end).as_rotvec())
        start_m, end_m = self.positions_m[before], self.positions_m[after]
        poses = np.tile(np.eye(4), (len(before), 1, 1))
        poses[:, :3, :3] = (start * turn).as_matrix()
        poses[:, :3, 3] = start_m + fraction * (end_m - start_m)
        return np.stack([require_rigid(pose, where=self.where) for pose in poses])

    def _around(self, stamps_ns: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Indices [M] of the last pose not after, and of the first not before, each time."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        after = np.searchsorted(self.stamps_ns, stamps, side="left")
        before = np.searchsorted(self.stamps_ns, stamps, side="right") - 1
        return before, after
