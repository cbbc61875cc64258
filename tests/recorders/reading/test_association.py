from __future__ import annotations

import random
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from proground_log.errors import ProgroundError
from recorders.reading.association import (
    Trajectory,
    associate,
    frame_stamp_ns,
    parse_pose,
    parse_stamp_ns,
    read_text,
    span_ns,
)

STAMPS = st.lists(st.integers(0, 60), unique=True, max_size=20)
LIMITS = st.integers(0, 15)
LATE_NS = 1_305_031_229_000_000_000


def stamp_pairs(first: list[int], second: list[int], limit: int) -> list[tuple[int, int]]:
    return [(first[i], second[j]) for i, j in associate(first, second, limit)]


@given(STAMPS, STAMPS, LIMITS)
def test_pairs_are_one_to_one_close_and_in_order(
    first: list[int], second: list[int], limit: int
) -> None:
    pairs = associate(first, second, limit)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    assert all(abs(first[i] - second[j]) <= limit for i, j in pairs)
    times = [first[i] for i, _ in pairs]
    assert times == sorted(times)


@given(STAMPS, STAMPS, LIMITS)
def test_no_two_would_rather_have_each_other(
    first: list[int], second: list[int], limit: int
) -> None:
    pairs = associate(first, second, limit)
    of_first = {i: abs(first[i] - second[j]) for i, j in pairs}
    of_second = {j: abs(first[i] - second[j]) for i, j in pairs}
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            if (difference := abs(a - b)) <= limit:
                better_for_both = difference < of_first.get(i, limit + 1) and (
                    difference < of_second.get(j, limit + 1)
                )
                assert not better_for_both


@given(STAMPS, STAMPS, LIMITS)
def test_swapping_the_lists_swaps_the_pairs(
    first: list[int], second: list[int], limit: int
) -> None:
    swapped = sorted((b, a) for a, b in stamp_pairs(second, first, limit))
    assert sorted(stamp_pairs(first, second, limit)) == swapped


@given(STAMPS, STAMPS, LIMITS, st.randoms(use_true_random=False))
def test_order_of_the_lists_does_not_matter(
    first: list[int], second: list[int], limit: int, shuffler: random.Random
) -> None:
    before = stamp_pairs(first, second, limit)
    shuffler.shuffle(first)
    shuffler.shuffle(second)
    assert stamp_pairs(first, second, limit) == before


@given(st.lists(st.integers(0, 5), max_size=12), st.lists(st.integers(0, 5), max_size=12), LIMITS)
def test_stamps_that_occur_twice_are_still_one_to_one(
    first: list[int], second: list[int], limit: int
) -> None:
    pairs = associate(first, second, limit)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)


def test_a_tie_goes_to_the_earlier_pair() -> None:
    assert associate([0, 20], [10], 10) == [(0, 0)]
    assert associate([10], [20, 0], 10) == [(0, 1)]


def test_nanoseconds_of_today_are_told_apart() -> None:
    now_ns = 1_763_800_000_123_456_789
    assert associate([now_ns], [now_ns + 1, now_ns + 2], 1) == [(0, 0)]


@given(st.integers(0, 9_000_000_000), st.integers(0, 999_999_999), st.integers(0, 9))
def test_decimal_seconds_are_exact(seconds: int, nanoseconds: int, digits: int) -> None:
    text = f"{seconds}.{nanoseconds:09d}"[: 10 - digits + len(str(seconds))]
    expected = seconds * 10**9 + nanoseconds // 10**digits * 10**digits
    assert parse_stamp_ns(text, where="rgb.txt") == expected


@given(st.decimals(0, 10**9, places=12))
def test_digits_beyond_a_nanosecond_are_rounded(seconds: Decimal) -> None:
    stamp_ns = parse_stamp_ns(str(seconds), where="rgb.txt")
    assert abs(Decimal(stamp_ns) - seconds * 10**9) <= Decimal("0.5")


@pytest.mark.parametrize(
    ("text", "stamp_ns"), [("1", 10**9), ("1.", 10**9), ("1.3e9", 13 * 10**17)]
)
def test_other_notations(text: str, stamp_ns: int) -> None:
    assert parse_stamp_ns(text, where="rgb.txt") == stamp_ns


@pytest.mark.parametrize(
    "text", ["", "x", "nan", "sNaN", "inf", "1/3", "1e99", "1e999999999", "1,5"]
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ProgroundError, match=r"rgb\.txt:3: .* is not a time in seconds"):
        parse_stamp_ns(text, where="rgb.txt:3")


def test_frame_numbers_are_times() -> None:
    assert [frame_stamp_ns(n, 30) for n in (0, 1, 30)] == [0, 33_333_333, 10**9]


def test_pose_text_round_trips() -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).as_matrix()
    pose[:3, 3] = [1, 2, 3]
    text = "\n".join(" ".join(repr(float(x)) for x in row) for row in pose)
    np.testing.assert_array_equal(parse_pose(text, where="p"), pose)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3", "16 numbers"),
        ("a " * 16, "16 numbers"),
        ("nan " * 16, "not finite"),
        ("2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1", "not rigid"),
    ],
)
def test_wrong_pose_text_is_refused(text: str, message: str) -> None:
    with pytest.raises(ProgroundError, match=rf"pose\.txt: .*{message}"):
        parse_pose(text, where="pose.txt")


def test_a_byte_order_mark_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"\xef\xbb\xbf# a comment\r\n")
    assert read_text(tmp_path / "a.txt") == "# a comment\n"


@pytest.mark.parametrize(("seconds", "ns"), [(0, 0), (0.02, 20_000_000), (1e9, 10**18)])
def test_a_length_of_time_in_nanoseconds(seconds: float, ns: int) -> None:
    assert span_ns(seconds, name="max_pose_gap_s") == ns


@pytest.mark.parametrize("seconds", [-0.02, 1e10, float("inf"), float("nan")])
def test_what_is_no_length_of_time_is_refused(seconds: float) -> None:
    with pytest.raises(ProgroundError, match=r"max_pose_gap_s: .* no length of time; choose"):
        span_ns(seconds, name="max_pose_gap_s")


def test_binary_file_is_not_read_as_text(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProgroundError, match="is not a text file"):
        read_text(tmp_path / "a.txt")


def screw(seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A turn about a fixed axis at 0.7 rad/s at a steady velocity: positions, rotation vectors."""
    axis = np.array([2.0, -1.0, 2.0]) / 3
    return np.outer(seconds, [0.3, -0.1, 0.2]), np.outer(0.7 * seconds, axis)


def screw_trajectory(*, max_gap_s: float = 0.5) -> Trajectory:
    seconds = np.arange(5) * 0.4
    positions_m, turns = screw(seconds)
    quaternions = Rotation.from_rotvec(turns).as_quat()
    quaternions[1::2] *= -1  # q and -q are one rotation: the short way round has to be found
    stamps_ns = LATE_NS + np.arange(5) * 400_000_000
    return Trajectory(stamps_ns, positions_m, quaternions, round(max_gap_s * 1e9), "gt.txt")


@given(st.integers(0, 1_600_000_000))
def test_steady_motion_is_interpolated_exactly(offset_ns: int) -> None:
    pose = screw_trajectory().at([LATE_NS + offset_ns])[0]
    positions_m, turns = screw(np.array([offset_ns / 1e9]))
    np.testing.assert_allclose(pose[:3, 3], positions_m[0], atol=1e-9)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_rotvec(turns[0]).as_matrix(), atol=1e-9)


@given(st.lists(st.integers(0, 1_600_000_000), min_size=1))
def test_many_times_at_once_equal_one_by_one(offsets_ns: list[int]) -> None:
    stamps_ns = [LATE_NS + offset_ns for offset_ns in offsets_ns]
    trajectory = screw_trajectory()
    one_by_one = np.concatenate([trajectory.at([stamp_ns]) for stamp_ns in stamps_ns])
    np.testing.assert_array_equal(trajectory.at(stamps_ns), one_by_one)


def test_agrees_with_slerp_on_any_rotations() -> None:
    rng = np.random.default_rng(8)
    rotations = Rotation.random(6, random_state=rng)
    stamps_ns = LATE_NS + np.cumsum(rng.integers(1, 10**9, 6))
    trajectory = Trajectory(stamps_ns, rng.normal(size=(6, 3)), rotations.as_quat(), 10**9, "gt")
    times_ns = np.sort(rng.integers(stamps_ns[0], stamps_ns[-1], 100))
    slerp = Slerp(stamps_ns - LATE_NS, rotations)
    expected = slerp(times_ns - LATE_NS).as_matrix()
    np.testing.assert_allclose(trajectory.at(list(times_ns))[:, :3, :3], expected, atol=1e-9)


@pytest.mark.parametrize("offset_ns", [-1, 1_600_000_001])
def test_nothing_is_extrapolated(offset_ns: int) -> None:
    trajectory = screw_trajectory()
    assert not trajectory.covers([LATE_NS + offset_ns])[0]
    with pytest.raises(ProgroundError, match=r"gt\.txt: there is no pose at 1305031"):
        trajectory.at([LATE_NS, LATE_NS + offset_ns])


def test_gaps_are_not_bridged_but_the_poses_count() -> None:
    trajectory = screw_trajectory(max_gap_s=0.3)
    covered = trajectory.covers([LATE_NS + 400_000_000, LATE_NS + 400_000_001])
    assert list(covered) == [True, False]


@pytest.mark.parametrize(
    ("stamps", "quaternion", "message"),
    [
        ([0, 1], [np.nan, 0, 0, 1], "not finite"),
        ([0, 1], [0, 0, 0, 2], "not of norm 1"),
        ([1, 1], [0, 0, 0, 1], "the same time"),
    ],
)
def test_wrong_trajectories_are_refused(
    stamps: list[int], quaternion: list[float], message: str
) -> None:
    with pytest.raises(ProgroundError, match=rf"gt\.txt: .*{message}"):
        Trajectory(
            np.array(stamps), np.zeros((2, 3)), np.array([[0, 0, 0, 1], quaternion]), 9, "gt.txt"
        )


def test_a_trajectory_without_poses_covers_nothing() -> None:
    empty = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)), 9, "gt.txt")
    assert not empty.covers([0]).any()
