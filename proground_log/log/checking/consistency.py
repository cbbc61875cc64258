"""Whether depth, poses and intrinsics fit one another: the frames of a recording judge themselves.

Depth of one frame is carried into another by their poses and compared with what was measured
there. Where that fails, or succeeds far better once a likely mistake is undone (`suspicions`), a
warning says which. Frames are thinned as they come, so that memory does not grow with them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from proground_log.camera import Calibration
from proground_log.frame import SensorFrame
from proground_log.log.checking.agreement import Agreement, Grid, Pair, View, agreement
from proground_log.log.checking.suspicions import (
    STILL,
    FactorSuspicion,
    Suspicion,
    factor_suspicions,
    rare_suspicions,
    suspicions,
)

GAPS = (1, 4, 16, 64)
"""How many frames apart a pair is: at 30 Hz neighbours hardly move, after 2 s most cameras did."""
PAIRS_PER_GAP = 24
LEAST_POINTS = 20
"""A pair with fewer samples of depth tells nothing."""

MUCH_BETTER = 1.15
"""How many times as well as the data as given a suspicion has to explain the frames."""
WINS_PER_LOSS = 3
LEAST_WINS = 3
DECISIVE = 0.02
"""Difference in a pair's score that counts as a win or a loss."""
LEAST_EXPLAINED = 0.7
"""Share of depth that has to agree with a mistake undone, for it to be named."""
DISAGREEING_LEFT = 0.6
"""How much of what disagreed may go on to disagree with it undone."""
SMALLEST_FACTOR = 1.15
"""Cameras whose nominal calibration is off by a few per cent are no mistake."""
EQUALLY_GOOD = 0.985
"""Of mistakes that explain the data to this share of the best, the first is named."""
FIT_STEP = 0.29
"""Of the logarithm of a factor: some 8 factors a decade, fine enough not to step over a peak."""
FIT_ROUNDS = 3
USUAL_REACH = 0.1
"""Of the logarithm: how near to the fitted factor a usual one, such as 5, may be preferred."""
AS_GOOD_AS_FITTED = 0.995
LEAST_AGREEING = 0.5
"""Below it a recording is wrong, whatever the reason; real ones that are right reach 0.9."""
SURELY_RIGHT = 0.93
"""From here on nothing is suspected: trying all mistakes takes some tenths of a second."""
LEAST_COMPARED = 0.02
LEAST_MOVED = 0.1
"""Share of pairs that a camera which stands still would have to explain otherwise."""


@dataclass(frozen=True)
class ConsistencyReport:
    """How well the frames of a recording agree.

    Args:
        median_relative_error: median difference of carried and measured depth, as a share of the
            depth; NaN where nothing could be compared.
        share_agreeing: share of the depth compared that agrees within `TOLERANCE`; NaN likewise.
        pairs: number of pairs of frames that had depth in common.
        note: the same in one line, for people.
        warnings: what seems wrong about the recording, and what to do.
    """

    median_relative_error: float
    share_agreeing: float
    pairs: int
    note: str
    warnings: tuple[str, ...]


class _Pairs:
    """Pairs of frames a fixed number of frames apart, spread evenly over all that came."""

    def __init__(self, gap: int) -> None:
        self._gap, self._stride = gap, 1
        self._by_first: dict[int, Pair] = {}

    def add(self, count: int, recent: deque[View]) -> None:
        """Note the pair that the newest of `count` frames completes."""
        first = count - 1 - self._gap
        if first < 0 or first % self._stride:
            return
        self._by_first[first] = (recent[-1 - self._gap], recent[-1])
        if len(self._by_first) > PAIRS_PER_GAP:
            self._stride *= 2
            self._by_first = {i: p for i, p in self._by_first.items() if i % self._stride == 0}

    def kept(self) -> Iterable[Pair]:
        """The pairs, in their order."""
        return self._by_first.values()


class Consistency:
    """Judges a recording as its frames come by, in constant memory."""

    def __init__(self) -> None:
        self._count = 0
        self._recent: deque[View] = deque(maxlen=max(GAPS) + 1)
        self._pairs = [_Pairs(gap) for gap in GAPS]
        self._grid: Grid | None = None

    def add(self, frame: SensorFrame, calibration: Calibration) -> None:
        """Look at the next frame; one with a broken pose or size is passed over.

        Args:
            frame: in the order of the recording.
            calibration: the recording's cameras; the frame's own go first.
        """
        camera = (frame.calibration or calibration).depth
        is_sound = np.isfinite(frame.world_from_camera).all()
        if not is_sound or frame.depth.shape != (camera.height, camera.width):
            return
        if self._grid is None or self._grid.camera != camera:
            self._grid = Grid(camera)
        self._recent.append(self._grid.view(frame))
        self._count += 1
        for pairs in self._pairs:
            pairs.add(self._count, self._recent)

    def report(self) -> ConsistencyReport:
        """What the frames so far tell; takes up to a second."""
        kept = [
            pair
            for pairs in self._pairs
            for pair in pairs.kept()
            if len(pair[0].depths_carried_m) >= LEAST_POINTS
        ]
        given = agreement(kept)
        pairs = int((given.compared > 0).sum())
        return ConsistencyReport(
            given.median_error, given.share_agreeing, pairs, *_judged(kept, given)
        )


def _judged(kept: list[Pair], given: Agreement) -> tuple[str, tuple[str, ...]]:
    """The note and the warnings."""
    overlaps = given.share_compared >= LEAST_COMPARED
    share, error = f"{given.share_agreeing:.0%}", given.median_error
    note = "too little depth overlaps to judge the poses"
    if overlaps:
        depth_m = _median_depth_m(kept)
        length = f", {error * depth_m * 100:.1f} cm at {depth_m:.1f} m" if error < 1 else ""
        note = f"{share} of depth agrees between frames (median {_percent(error)}{length}), "
        note += f"{int((given.compared > 0).sum())} pairs"
    is_right = overlaps and given.share_agreeing >= SURELY_RIGHT
    if not is_right and (named := _best_suspicion(kept, given)) is not None:
        mistake, undone = named
        found = "next to no depth is seen twice"
        if overlaps:
            found = f"{share} of the depth seen twice agrees, median error {_percent(error)}"
        better = f"{undone.share_agreeing:.0%} agrees, median error {_percent(undone.median_error)}"
        return note, (
            f"frames do not agree: {found}; with {mistake.undone} {better}: {mistake.todo}",
        )
    if not overlaps:
        return note, ()
    moved = np.abs(agreement(kept, STILL).scores - given.scores) > DECISIVE
    hardly_moves = moved.mean() < LEAST_MOVED
    if given.share_agreeing < LEAST_AGREEING:
        why = "no usual mistake explains it"
        if hardly_moves:
            why = "the poses hardly change, though what the camera sees does"
        todo = "check that poses, depth and calibration belong together, and their times"
        return note, (
            f"frames do not agree: only {share} of the depth seen twice does, and {why}: {todo}",
        )
    if hardly_moves:
        note += "; the camera hardly moves: poses cannot be judged"
    return note, ()


def _percent(share: float) -> str:
    return f"{share:.1%}" if share < 1 else "over 100%"


def _median_depth_m(kept: list[Pair]) -> float:
    return float(np.median(np.concatenate([first.depths_carried_m for first, _ in kept])))


def _best_suspicion(kept: list[Pair], given: Agreement) -> tuple[Suspicion, Agreement] | None:
    """The mistake that explains the data much better than the data as given, with its evidence."""
    if not kept:
        return None
    explains = [
        (mistake, undone) for mistake, undone in _tried(kept) if _is_much_better(undone, given)
    ]
    best = max((undone.score for _, undone in explains), default=0.0)
    return next((each for each in explains if each[1].score >= EQUALLY_GOOD * best), None)


def _tried(kept: list[Pair]) -> Iterator[tuple[Suspicion, Agreement]]:
    """Every mistake, the likely ones first, and how well the pairs agree without it."""
    for suspicion in suspicions():
        yield suspicion, agreement(kept, suspicion)
    for by_factor in factor_suspicions(_median_depth_m(kept)):
        factor, undone = _fit(kept, by_factor)
        if max(factor, 1 / factor) >= SMALLEST_FACTOR:
            yield by_factor.of(factor), undone
    for suspicion in rare_suspicions():
        yield suspicion, agreement(kept, suspicion)


def _is_much_better(evidence: Agreement, given: Agreement) -> bool:
    """Whether a mistake undone explains the data, and better in nearly every pair that tells."""
    difference = evidence.scores - given.scores
    wins, losses = int((difference > DECISIVE).sum()), int((difference < -DECISIVE).sum())
    # Without anything compared, NaN, nothing agrees.
    disagreed = 1 - np.nan_to_num(given.share_agreeing)
    return (
        evidence.score >= MUCH_BETTER * given.score
        and wins >= max(LEAST_WINS, WINS_PER_LOSS * losses)
        and evidence.share_agreeing >= LEAST_EXPLAINED
        and 1 - evidence.share_agreeing <= DISAGREEING_LEFT * disagreed
    )


def _fit(kept: list[Pair], suspicion: FactorSuspicion) -> tuple[float, Agreement]:
    """The factor that makes the pairs agree best, found from coarse to fine, and how they do."""
    step = FIT_STEP
    count = round(np.log(suspicion.highest / suspicion.lowest) / step) + 1
    factors = np.geomspace(suspicion.lowest, suspicion.highest, count)
    best, evidence = 1.0, agreement(kept)
    for _ in range(FIT_ROUNDS):
        for factor in factors.tolist():
            tried = agreement(kept, suspicion.of(factor))
            if tried.score > evidence.score:
                best, evidence = factor, tried
        factors, step = best * np.exp(np.linspace(-step, step, 9)), step / 4
    for factor in suspicion.usual:
        if abs(np.log(factor / best)) < USUAL_REACH:
            tried = agreement(kept, suspicion.of(factor))
            if tried.score >= AS_GOOD_AS_FITTED * evidence.score:
                return factor, tried
    return best, evidence
