"""The mistakes that data sets and their readers make with poses and cameras, and what undoes each.

A table without data: `consistency` tries which of them makes the frames of a recording agree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

Change = Callable[[np.ndarray], np.ndarray]

PLAUSIBLE_DEPTH_M = (0.2, 20.0)
"""The median depth of what RGB-D cameras are used for; tells wrong depth from wrong positions."""

_DIRECTIONS = (("right", "left"), ("down", "up"), ("forward", "back"))
_COMMON_AXES = {
    "x right, y up, z back": " (OpenGL's)",
    "x forward, y left, z up": " (a robot's body, not its camera)",
}
_DEPTH_UNITS = {
    5.0: ", as between 1/5000 m and millimetres",
    6.5535: ", as between 1/6553.5 m and millimetres",
    1.3107: ", as between 1/6553.5 m and 1/5000 m",
    1000.0: ", as between millimetres and metres",
}


def _unchanged(values: np.ndarray) -> np.ndarray:
    return values


@dataclass(frozen=True)
class Suspicion:
    """A mistake that a recording may have.

    Args:
        undone: how the data is read without it, after "with".
        todo: what it seems to be and what to do about it.
        poses: takes poses [N, 4, 4] as given to what they should be, which may mirror.
        intrinsics: likewise for fx, fy, cx, cy [N, 4].
        along_ray: whether depth was measured along the ray, not along z.
    """

    undone: str
    todo: str
    poses: Change = _unchanged
    intrinsics: Change = _unchanged
    along_ray: bool = False


AS_GIVEN = Suspicion("the data as given", "")
STILL = Suspicion(
    "a camera that stands still", "", lambda poses: np.broadcast_to(np.eye(4), poses.shape)
)


@dataclass(frozen=True)
class FactorSuspicion:
    """A mistake by a factor that the data has to tell.

    Args:
        lowest, highest: where to look for the factor that undoes it.
        usual: factors to prefer where they explain the data as well.
        of: the suspicion for a factor.
    """

    lowest: float
    highest: float
    usual: tuple[float, ...]
    of: Callable[[float], Suspicion]


def suspicions() -> Iterator[Suspicion]:
    """The common mistakes; of those that explain the data equally, the first is meant."""
    yield Suspicion(
        "the poses inverted", "they seem to be camera-from-world: invert them", inverted
    )
    for axes in filter(_is_common, _all_axes()):
        yield from _axes_suspicions(axes)
    yield from _quaternion_suspicions()
    yield Suspicion(
        "the rotations transposed",
        "they seem to be world-to-camera, the positions not: transpose the rotations",
        _transposed,
    )
    yield Suspicion(
        "the positions turned into the world",
        "they seem to be the translations t of camera-from-world, the rotations R not: "
        "the position is -R t",
        _turned_positions,
    )
    yield Suspicion(
        "cx and cy swapped",
        "they seem to be the wrong way round: put cx first, or transpose the matrix K",
        intrinsics=lambda k: k[..., [0, 1, 3, 2]],
    )
    yield Suspicion(
        "depth taken along the ray",
        "it seems to be the distance to the camera: turn it into depth along z",
        along_ray=True,
    )


def factor_suspicions(median_depth_m: float) -> Iterator[FactorSuspicion]:
    """Common mistakes by a factor, in a recording of this median depth as given."""
    units = (*_DEPTH_UNITS, 10.0, 100.0)
    usual = (*units, *(1 / unit for unit in units))
    yield FactorSuspicion(1e-4, 1e4, usual, partial(_depth_scale, median_depth_m=median_depth_m))
    yield FactorSuspicion(0.2, 5.0, (0.5, 2.0), _focal_length)
    yield FactorSuspicion(0.1, 10.0, (0.5, 2.0), _resolution)


def rare_suspicions() -> Iterator[Suspicion]:
    """Every other way to name the camera's axes, those that mirror last."""
    others = [axes for axes in _all_axes() if not _is_common(axes)]
    for axes in sorted(others, key=_mirrors):
        yield from _axes_suspicions(axes)


def inverted(poses: np.ndarray) -> np.ndarray:
    """The inverse of rigid transforms [..., 4, 4]; written out, to be the same everywhere."""
    rotations = poses[..., :3, :3].swapaxes(-1, -2)
    return _poses(rotations, -(rotations * poses[..., None, :3, 3]).sum(axis=-1))


def _poses(rotations: np.ndarray, positions_m: np.ndarray) -> np.ndarray:
    poses = np.zeros((*rotations.shape[:-2], 4, 4))
    poses[..., :3, :3], poses[..., :3, 3], poses[..., 3, 3] = rotations, positions_m, 1.0
    return poses


def _transposed(poses: np.ndarray) -> np.ndarray:
    return _poses(poses[..., :3, :3].swapaxes(-1, -2), poses[..., :3, 3])


def _turned_positions(poses: np.ndarray) -> np.ndarray:
    return inverted(_transposed(poses))


def _axes_suspicions(axes: np.ndarray) -> Iterator[Suspicion]:
    """The given poses, or their inverses, are of a camera with these axes (`_all_axes`)."""
    words = _in_words(axes)
    kind = " (mirrored: is fy negative?)" if _mirrors(axes) else _COMMON_AXES.get(words, "")
    seems = f"the camera's axes seem to be {words}{kind}"
    yield Suspicion("other camera axes", f"{seems}: turn them", partial(_renamed, axes=axes))
    yield Suspicion(
        "the poses inverted and other camera axes",
        f"they seem to be camera-from-world, and {seems}: invert and turn them",
        partial(_inverted_and_renamed, axes=axes),
    )


def _renamed(poses: np.ndarray, *, axes: np.ndarray) -> np.ndarray:
    return poses @ _poses(axes, np.zeros(3))


def _inverted_and_renamed(poses: np.ndarray, *, axes: np.ndarray) -> np.ndarray:
    return _renamed(inverted(poses), axes=axes)


def _quaternion_suspicions() -> Iterator[Suspicion]:
    for shift, order, read_as in ((-1, "w x y z", "x y z w"), (1, "x y z w", "w x y z")):
        undone = f"the quaternions as {order}"
        todo = f"they seem to be {order}, read as {read_as}: reorder them"
        invert = "and the poses camera-from-world: invert them"
        yield Suspicion(undone, todo, partial(_reordered, shift=shift))
        yield Suspicion(
            f"{undone}, before the poses were inverted",
            todo,
            partial(_reordered, shift=shift, before=inverted, after=inverted),
        )
        yield Suspicion(
            f"{undone} and the poses inverted",
            f"{todo}, {invert}",
            partial(_reordered, shift=shift, after=inverted),
        )


def _reordered(
    poses: np.ndarray, *, shift: int, before: Change = _unchanged, after: Change = _unchanged
) -> np.ndarray:
    """The poses with the numbers of their quaternions moved on by `shift` places."""
    poses = before(poses)
    quaternions = np.roll(Rotation.from_matrix(poses[..., :3, :3]).as_quat(), shift, axis=-1)
    return after(_poses(Rotation.from_quat(quaternions).as_matrix(), poses[..., :3, 3]))


def _depth_scale(factor: float, *, median_depth_m: float) -> Suspicion:
    """Depth times a factor, or positions divided by it: to the frames it is the same."""
    times = _rounded(max(factor, 1 / factor))
    depth_is, positions_are = ("large", "small") if factor < 1 else ("small", "large")
    depth = f"depth seems about {times} times too {depth_is}"
    positions = f"positions seem about {times} times too {positions_are}"
    lowest_m, highest_m = PLAUSIBLE_DEPTH_M
    if not lowest_m < median_depth_m < highest_m:
        seems = depth
    elif not lowest_m < median_depth_m * factor < highest_m:
        seems = positions
    else:
        seems = f"{depth} or {positions}"
    unit = next((text for usual, text in _DEPTH_UNITS.items() if factor in (usual, 1 / usual)), "")
    return Suspicion(
        f"depth {_times(factor)}",
        f"{seems}{unit}: mend the unit",
        lambda poses: _poses(poses[..., :3, :3], poses[..., :3, 3] / factor),
    )


def _focal_length(factor: float) -> Suspicion:
    times, is_off = _rounded(max(factor, 1 / factor)), "long" if factor < 1 else "short"
    return Suspicion(
        f"the focal length {_times(factor)}",
        f"it seems about {times} times too {is_off}: pass the depth camera's own calibration",
        intrinsics=lambda k: k * np.array([factor, factor, 1.0, 1.0]),
    )


def _resolution(factor: float) -> Suspicion:
    times, is_off = _rounded(max(factor, 1 / factor)), "larger" if factor < 1 else "smaller"
    return Suspicion(
        f"all intrinsics {_times(factor)}",
        f"they seem to be of an image about {times} times {is_off}: "
        "pass the calibration at the depth image's size",
        intrinsics=lambda k: k * factor,
    )


def _times(factor: float) -> str:
    return f"{'divided' if factor < 1 else 'multiplied'} by {_rounded(max(factor, 1 / factor))}"


def _rounded(number: float) -> str:
    """Two digits, without an exponent."""
    return f"{float(f'{number:.2g}'):g}"


def _all_axes() -> Iterator[np.ndarray]:
    """Every way to name axes but ours: row i is the camera's axis i in our axes, [3, 3]."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        axes = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if not np.array_equal(axes, np.eye(3)):
            yield axes


def _mirrors(axes: np.ndarray) -> bool:
    return bool(np.linalg.det(axes) < 0)


def _is_common(axes: np.ndarray) -> bool:
    return _in_words(axes) in _COMMON_AXES


def _in_words(axes: np.ndarray) -> str:
    towards = (_DIRECTIONS[int(np.abs(row).argmax())][int(row.min() < 0)] for row in axes)
    return ", ".join(f"{name} {word}" for name, word in zip("xyz", towards, strict=True))
