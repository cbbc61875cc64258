"""Perception that runs beside the mapper: frames whose regions are still being found."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from proground_log.frame import Frame, SensorFrame
from proground_log.log.reader import LogReader
from replay.plan import Turn
from replay.scheduler import RegionsReady


class FramesBeside:
    """Frames that were mapped without their regions, until these come.

    Perception takes the newest frame: older ones that waited never get their turn.
    """

    def __init__(self) -> None:
        self._frames: dict[int, Frame] = {}

    def add(self, frame: Frame) -> None:
        """A frame whose regions come later; it has them already, the mapper does not know them."""
        self._frames[frame.index] = frame

    def take(self, index: int) -> Frame:
        """The frame whose regions are there; what is older is forgotten."""
        frame = self._frames.pop(index)
        self._frames = {n: f for n, f in self._frames.items() if n > index}
        return frame

    def recall(
        self,
        taken: Sequence[Turn],
        reader: LogReader,
        perceived: Callable[[SensorFrame], Frame],
    ) -> None:
        """Read again the frames that are on their way after some turns, to go on from there.

        Args:
            taken: the turns that are over.
            reader: the log.
            perceived: gives a frame its regions.
        """
        due: list[int] = []
        for turn in taken:
            if turn.slot is None:
                continue
            due += [turn.slot.frame] * turn.slot.is_perceived
            for event in turn.slot.meanwhile:
                if isinstance(event, RegionsReady):
                    due = [frame for frame in due if frame > event.frame]
        for sensor in reader.frames(due) if due else ():
            self.add(perceived(sensor))
