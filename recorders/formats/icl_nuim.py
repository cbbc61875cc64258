"""ICL-NUIM, its archives that are compatible with TUM RGB-D: rendered rooms, exact trajectories.

A folder has rgb/N.png, depth/N.png (uint16 / 5000 m along z), associations.txt
(`N depth/N.png N rgb/N.png` a line) and a pose file: *.gt.freiburg (`N tx ty tz qx qy qz qw` a
line) or *.gt.sim (3x4 blocks in order, without numbers). The first frames may lack a pose.

The poses are of a renderer whose camera has x right, y UP, z forward: left-handed, which is why
the published fy is -480. With F = diag(1, -1, 1, 1), a point of our camera is F times the
renderer's, so that F T F is a pose of a camera with fy = 480, in the world mirrored by F.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera, require_rigid
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.tum import read_trajectory
from recorders.reading.association import SECOND_NS, frame_stamp_ns, read_text
from recorders.reading.frame_files import FrameFiles
from recorders.reading.layout import holds

FRAME_RATE_HZ = 30
DEPTH_PER_M = 5000
CAMERA = Camera.from_integer_centres(640, 480, 481.2, 480.0, 319.5, 239.5)
FLIP = np.diag([1.0, -1.0, 1.0, 1.0])
POSE_FILES = ("*.gt.freiburg", "*.gt.sim")
ASSOCIATION = re.compile(r"\S+\s+(depth|rgb)/(\d{1,9})\.png\s+\S+\s+(depth|rgb)/(\d{1,9})\.png")


def recognise(source: Path) -> str | None:
    """Why a path looks like a trajectory of ICL-NUIM; None where it does not."""
    for pattern in POSE_FILES:
        if holds(source, "associations.txt", pattern):
            return f"has associations.txt and {pattern}"
    return None


class IclNuimSource:
    """One trajectory; frames are in the order of their numbers."""

    name = "icl-nuim"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        trajectory: Path | None = None,
    ) -> None:
        """Read the list of images and the poses.

        Args:
            source: the trajectory's folder, such as living_room_traj2_frei_png.
            calibration: the rig; by default the data set's camera.
            trajectory: the pose file; by default the folder's one *.gt.freiburg, or *.gt.sim.

        Raises:
            ProgroundError: a file is missing or broken, or no frame has a pose.
        """
        self.calibration = calibration or Calibration.registered(CAMERA)
        self.label_names: dict[int, str] = {}
        self.warnings: tuple[str, ...] = ()
        pairs = _read_associations(source / "associations.txt")
        path = trajectory or _only_pose_file(source)
        read = _read_blocks if path.suffix == ".sim" else _read_numbered
        poses = read(path, [number for number, _ in pairs])
        self._frames = [
            FrameFiles(
                stamp_ns=frame_stamp_ns(number, FRAME_RATE_HZ),
                color_stamp_ns=frame_stamp_ns(color_number, FRAME_RATE_HZ),
                color=source / "rgb" / f"{color_number}.png",
                depth=source / "depth" / f"{number}.png",
                world_from_camera=FLIP @ poses[number] @ FLIP,
            )
            for number, color_number in pairs
            if number in poses
        ]
        self.notes = {
            "frames without a pose": str(len(pairs) - len(self._frames)),
            "world axes": "the published world, which is left-handed, with its y axis turned over",
        }
        if not self._frames:
            raise ProgroundError(
                f"has a pose for none of {len(pairs)} frames",
                where=path,
                todo="give the images and the pose file of one and the same trajectory",
            )

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is float32 in metres."""
        return self._frames[index].read(index, self.calibration, depth_per_m=DEPTH_PER_M)

    def ground_truth_mesh(self) -> bytes | None:
        """The published mesh has no labels."""
        return None


def _read_associations(path: Path) -> list[tuple[int, int]]:
    """Numbers of the depth image and the colour image of each frame, ascending."""
    pairs: dict[int, int] = {}
    for line_number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        match = ASSOCIATION.fullmatch(line.strip())
        numbers = {match[1]: int(match[2]), match[3]: int(match[4])} if match else {}
        if len(numbers) != 2 or numbers["depth"] in pairs:
            raise ProgroundError(
                "is not a pair of images `N depth/N.png N rgb/N.png`, or repeats one",
                where=f"{path}:{line_number}",
                todo="mend or remove the line",
            )
        pairs[numbers["depth"]] = numbers["rgb"]
    return sorted(pairs.items())


def _only_pose_file(source: Path) -> Path:
    """The one pose file; numbered poses before those without numbers."""
    for pattern in POSE_FILES:
        found = sorted(source.glob(pattern))
        if len(found) == 1:
            return found[0]
        if found:
            raise ProgroundError(
                f"has several pose files ({', '.join(path.name for path in found)})",
                where=source,
                todo="pass one of them as `trajectory`",
            )
    raise ProgroundError(
        f"has no {' and no '.join(POSE_FILES)}",
        where=source,
        todo="pass the pose file as `trajectory`",
    )


def _read_numbered(path: Path, numbers: list[int]) -> dict[int, np.ndarray]:
    """Published poses [4, 4] of those frames that *.gt.freiburg has, by number."""
    trajectory = read_trajectory(path)
    # The numbers stand where TUM has seconds; poses a second apart are not interpolated between.
    covered = trajectory.covers([number * SECOND_NS for number in numbers])
    known = [number for number, has_pose in zip(numbers, covered, strict=True) if has_pose]
    if not known:
        return {}
    return dict(zip(known, trajectory.at([n * SECOND_NS for n in known]), strict=True))


def _read_blocks(path: Path, numbers: list[int]) -> dict[int, np.ndarray]:
    """Published poses [4, 4] of *.gt.sim, by number: where there are fewer, of the last frames."""
    try:
        blocks = np.array(read_text(path).split(), dtype=np.float64).reshape(-1, 3, 4)
    except ValueError as error:
        raise ProgroundError(
            "is not a list of 3x4 poses", where=path, todo="copy the file from the data set again"
        ) from error
    if len(blocks) > len(numbers):
        raise ProgroundError(
            f"has {len(blocks)} poses for {len(numbers)} frames",
            where=path,
            todo="give the images and the pose file of one and the same trajectory",
        )
    last_row = np.array([[0.0, 0.0, 0.0, 1.0]])
    return {
        number: require_rigid(np.concatenate([block, last_row]), where=f"{path}, frame {number}")
        for number, block in zip(numbers[len(numbers) - len(blocks) :], blocks, strict=True)
    }
