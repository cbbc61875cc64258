"""A plan that ends in the middle of a frame, between two of its steps."""

from __future__ import annotations

from collections.abc import Iterator

from proground_log.log.reader import LogReader
from replay.config import ReplayConfig
from replay.cost_model import CostModel
from replay.plan import Plan, Turn
from replay.scheduler import Slot


class CutPlan(Plan):
    """The plan of a run, up to some step of a mapped frame.

    Args:
        reader, config, cost_model, perceives: as for `Plan`.
        frame: number of the frame in its log.
        steps: the frame's steps up to there, at least 1.
    """

    def __init__(
        self,
        reader: LogReader,
        config: ReplayConfig,
        cost_model: CostModel,
        *,
        perceives: bool,
        frame: int,
        steps: int,
    ) -> None:
        super().__init__(reader, config, cost_model, perceives=perceives)
        self._frame, self._cut_steps = frame, steps

    def turns(self) -> Iterator[Turn]:
        """The turns up to the frame, and one that is never taken: a replay stops before its end."""
        for turn in super().turns():
            if turn.frame == self._frame and turn.slot is not None:
                yield turn._replace(slot=self._cut(turn.slot))
                yield turn
                return
            yield turn

    def _cut(self, slot: Slot) -> Slot:
        step_ns = self.timing.step_ns
        last_ns = slot.end_ns - (slot.steps - self._cut_steps + 1) * step_ns
        return slot._replace(
            steps=self._cut_steps,
            end_ns=last_ns + step_ns,
            meanwhile=tuple(event for event in slot.meanwhile if event.at_ns <= last_ns),
        )
