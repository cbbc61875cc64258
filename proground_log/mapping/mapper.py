"""What every mapper is to a replay: the other half of the socket.

A mapper knows no clock, no file and no viewer. Provisional until 1.0: a member may be added or
change its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from proground_log.events import Counts, Event, SemanticScores
from proground_log.frame import Frame
from proground_log.mapping.map import Map
from proground_log.perception.description import PerceptionDescription


@dataclass(frozen=True)
class StepResult:
    """What an optimisation step did.

    Args:
        losses: each term by name, unweighted, and "total", the weighted sum; float32 values.
        draws_digest: sha256 over all that was drawn for it, hexadecimal.
    """

    losses: dict[str, float]
    draws_digest: str


class Mapper(Protocol):
    """Makes a map of frames, one after the other.

    What it does depends on its settings, its seed and what it was given alone: no clock, no thread
    and no order of a dictionary reaches a result.

    Attributes:
        description: what the meaning that it learns is of; None where it learns none.
    """

    @property
    def description(self) -> PerceptionDescription | None: ...

    def insert(self, frame: Frame, *, is_keyframe: bool) -> Sequence[Event]:
        """Take a frame in, with its regions where they are known; returns what to tell of it."""
        ...

    def insert_regions(self, frame: Frame) -> None:
        """Learn what a frame means that was inserted before its regions were known."""
        ...

    def steps(self, count: int) -> list[StepResult]:
        """Do so many optimisation steps; fewer where there is nothing to learn from.

        A mapper of a kind whose frames cost no steps is never asked.
        """
        ...

    def scores(self, frame_index: int) -> SemanticScores | None:
        """How well it gives back the regions it was shown, for the eye; None: it does not know."""
        ...

    def counts(self) -> Counts:
        """What it holds, group by group; the same groups and figures at any time."""
        ...

    def finish(self) -> None:
        """The last frame is in: do what can only be done now. Called once, before the last map."""
        ...

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame builds on, by name. Views, not copies: good until then."""
        ...

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` returned, after a frame."""
        ...

    def map(self) -> Map:
        """The map so far; cheap, and good until the next frame or step."""
        ...
