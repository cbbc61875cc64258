"""What a perceiver is."""

from __future__ import annotations

from typing import Protocol

from proground_log.frame import SensorFrame
from proground_log.perception.description import PerceptionDescription
from proground_log.regions import Regions


class Perceiver(Protocol):
    """Finds regions in colour images; equal frames give equal regions, in any order."""

    @property
    def description(self) -> PerceptionDescription:
        """What makes its regions; a perceiver of the same description finds the same ones."""

    def __call__(self, frame: SensorFrame, /) -> Regions:
        """The regions of a frame's colour image."""
