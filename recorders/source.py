"""What every recorder gives: a data set as a sequence of sensor frames."""

from __future__ import annotations

from typing import Protocol

from proground_log.camera import Calibration
from proground_log.frame import SensorFrame


class Source(Protocol):
    """A data set on disk (or a built-in scene), opened and checked; frames are read one by one.

    Attributes:
        name: the format's name, as on the command line.
        calibration: the rig's cameras.
        label_names: class names by label; label 0 is "nothing"; empty without ground truth.
        notes: what was left out or assumed, by keyword, for the log.
        warnings: what looks wrong about the data set as it was opened, in sentences.
    """

    name: str
    calibration: Calibration
    label_names: dict[int, str]
    notes: dict[str, str]
    warnings: tuple[str, ...]

    def __len__(self) -> int: ...

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; raises a ProgroundError that names the file at fault."""
        ...

    def ground_truth_mesh(self) -> bytes | None:
        """The labelled ground-truth mesh as binary PLY, where the source has one."""
        ...
