"""What a kind of mapper is measured with, for a cost model; see `pglog calibrate`."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from proground_log.bounds import Bounds
from proground_log.camera import Camera
from proground_log.frame import Frame
from proground_log.mapping.mapper import Mapper
from proground_log.perception.description import PerceptionDescription

FRAMES_BEFORE = 16
"""What a mapper has seen before it is measured: it is in the state of the middle of a replay."""


class Work(NamedTuple):
    """A stage at one size.

    Args:
        units: the size, in the stage's unit.
        run: does it.
        times: how often, in one call.
    """

    units: int
    run: Callable[[], object]
    times: int = 1


Works = dict[str, Callable[[], list[Work]]]
"""By stage what makes its work ready, at several sizes."""


@dataclass(frozen=True)
class Bench:
    """What mappers are measured with.

    Args:
        bounds: the box that is mapped.
        perception: what the frames' regions mean.
        cameras: of the sizes at which frames are inserted.
        own: the log's own camera.
        frames: for a camera, frames without end, with regions, numbered from 0.
        keyframe_every: every so many frames, one is a keyframe.
    """

    bounds: Bounds
    perception: PerceptionDescription
    cameras: Sequence[Camera]
    own: Camera
    frames: Callable[[Camera], Iterator[Frame]]
    keyframe_every: int

    def insert(self, mapper: Mapper, frames: Iterator[Frame], count: int) -> None:
        """Insert so many frames, with keyframes among them as in a replay."""
        for number, frame in enumerate(itertools.islice(frames, count)):
            mapper.insert(frame, is_keyframe=number % self.keyframe_every == 0)

    def in_use(self, mapper: Mapper, camera: Camera) -> Iterator[Frame]:
        """Let a mapper see some frames of a camera; the frames that it would get next."""
        frames = self.frames(camera)
        self.insert(mapper, frames, FRAMES_BEFORE)
        return frames
