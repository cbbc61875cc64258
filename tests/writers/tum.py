"""Writes tum data as its public description has it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from proground_log.camera import Calibration, Camera

CAMERA = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)


CALIBRATION = Calibration.registered(CAMERA)


DEPTH_STAMPS = ("100.000000", "100.100000", "100.200000", "100.300001")


COLOR_STAMPS = ("99.995", "100.110", "100.190", "100.310")


GROUND_TRUTH = """# time tx ty tz qx qy qz qw

99.95 1 2 3 0 0 0 1
100.05 3 2 3 0 0 0 1
100.15 3 4 3 0 0 0.7071 0.7071
100.25 3 4 3 0 0 1 0
"""


def write_sequence(folder: Path, *, ground_truth: str = GROUND_TRUTH) -> list[np.ndarray]:
    """Write four pairs, the last without a pose; returns the depth images in the files' unit."""
    rng = np.random.default_rng(4)
    folder.mkdir(parents=True)
    (folder / "groundtruth.txt").write_text(ground_truth)
    depths = []
    for name, stamps in (("depth", DEPTH_STAMPS), ("rgb", COLOR_STAMPS)):
        (folder / name).mkdir()
        lines = [f"{stamp} {name}/{stamp}.png" for stamp in stamps]
        (folder / f"{name}.txt").write_text("# a comment\n" + "\n".join(lines) + "\n")
        for stamp in stamps:
            if name == "depth":
                depths.append(rng.integers(0, 65536, (24, 32), dtype=np.uint16))
                cv2.imwrite(str(folder / f"depth/{stamp}.png"), depths[-1])
            else:
                color = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
                cv2.imwrite(str(folder / f"rgb/{stamp}.png"), color)
    return depths
