"""What every recorder has to pass: a fixture's frames, recorded and read back, are the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from proground_log.frame import Selection, SensorFrame
from proground_log.log.checking.check import check_log
from proground_log.log.reader import LogReader
from recorders.record import record
from recorders.source import Source


def assert_round_trip(
    source: Source,
    expected: Sequence[SensorFrame],
    path: Path,
    *,
    depth_atol_m: float = 0.0,
    same_bytes: bool = True,
    world_from_expected: np.ndarray | None = None,
) -> LogReader:
    """Record a source twice, and compare the log with what was put into the fixture.

    Args:
        source: opened on the fixture.
        expected: the frames that the fixture was written from; times are not compared.
        path: where to write the log.
        depth_atol_m: what the format's unit of depth loses; 0 where it holds millimetres.
        same_bytes: whether the format keeps encoded colour; else the pixels are compared.
        world_from_expected: where the format has other world axes, [4, 4].

    Returns:
        The log.
    """
    quiet = lambda *_: None  # noqa: E731
    record(source, "fixture", path, Selection(), overwrite=False, progress=quiet)
    again = path.with_suffix(".again.mcap")
    record(source, "fixture", again, Selection(), overwrite=False, progress=quiet)
    assert path.read_bytes() == again.read_bytes()
    assert check_log(path, quiet) == []
    reader = LogReader(path)
    assert len(reader) == len(expected)
    world = np.eye(4) if world_from_expected is None else world_from_expected
    for frame, wanted in zip(reader.frames(), expected, strict=True):
        if same_bytes:
            assert bytes(frame.color) == wanted.color
        np.testing.assert_array_equal(frame.decode_color(), wanted.decode_color())
        np.testing.assert_allclose(frame.depth_m, wanted.depth_m, rtol=1e-6, atol=depth_atol_m)
        np.testing.assert_allclose(
            frame.world_from_camera, world @ wanted.world_from_camera, rtol=0, atol=1e-6
        )
        for found, put in ((frame.labels, wanted.labels), (frame.instances, wanted.instances)):
            if found is not None and put is not None:
                np.testing.assert_array_equal(found, put)
    return reader
