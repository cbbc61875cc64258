"""Redwood, and Open3D's own recordings: a hand-held camera with a reconstructed trajectory.

A folder has image/, color/ or rgb/ and depth/ with files named by number (00012.jpg, 00012.png)
or by number and microseconds (0000012-000000369507.png), trajectory.log (blocks of `i i n` and the
4x4 world_from_camera of the i-th depth image, from 0) and, perhaps, camera_intrinsic.json.
Depth is uint16 in millimetres.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.reading.association import (
    associate,
    frame_stamp_ns,
    parse_pose,
    read_text,
    span_ns,
)
from recorders.reading.frame_files import FrameFiles
from recorders.reading.images import numbered_files
from recorders.reading.json_file import read_json
from recorders.reading.layout import holds

FRAME_RATE_HZ = 30
COLOR_FOLDERS = ("image", "color", "rgb")
CAMERA = Camera.from_integer_centres(640, 480, 525.0, 525.0, 319.5, 239.5)
"""The data set's page; depth is registered to colour."""
INTRINSIC_EXAMPLE = '{"width": 640, "height": 480, "intrinsic_matrix": [9 numbers, by columns]}'


def recognise(source: Path) -> str | None:
    """Why a path looks like Redwood or Open3D; None where it does not."""
    for name in COLOR_FOLDERS:
        if holds(source, "trajectory.log", f"{name}/*", "depth/*.png"):
            return f"has trajectory.log, {name}/ and depth/"
    return None


class RedwoodSource:
    """One sequence: each depth image that has a pose, with the closest colour image."""

    name = "redwood"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        trajectory: Path | None = None,
        max_time_difference_s: float = 0.02,
    ) -> None:
        """Find the images, pair them one to one by time, and read their poses.

        Args:
            source: the sequence's folder.
            calibration: the rig; by default of camera_intrinsic.json, else the data set's.
            trajectory: the file of poses; by default the folder's trajectory.log, or its one .log.
            max_time_difference_s: the largest time between the two images of a pair.

        Raises:
            ProgroundError: a file is missing or broken, or no image has a partner and a pose.
        """
        self.calibration = calibration or Calibration.registered(_read_camera(source))
        self.label_names: dict[int, str] = {}
        self.warnings: tuple[str, ...] = ()
        colors = _timed_files(_color_folder(source), r"(\d{1,9})(?:-\d{1,15})?\.(?:png|jpe?g)")
        depths = _timed_files(source / "depth", r"(\d{1,9})(?:-\d{1,15})?\.png")
        path = trajectory or _only_log(source)
        poses = _read_log(path, images=len(depths))
        limit_ns = span_ns(max_time_difference_s, name="max_time_difference_s")
        pairs = associate([at for at, _ in depths], [at for at, _ in colors], limit_ns)
        self._frames = [
            FrameFiles(depths[i][0], colors[j][0], colors[j][1], depths[i][1], poses[i])
            for i, j in pairs
            if i in poses
        ]
        self.notes = {
            "images without a partner": str(len(depths) - len(pairs)),
            "frames without a pose": str(len(pairs) - len(self._frames)),
        }
        if not self._frames:
            raise ProgroundError(
                f"no frame: {len(depths)} depth and {len(colors)} colour images make "
                f"{len(pairs)} pairs within {max_time_difference_s} s, none of {len(poses)} poses "
                "is of one",
                where=source,
                todo=f"check the names of the images, and {path.name}",
            )

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is uint16 in millimetres."""
        return self._frames[index].read(index, self.calibration)

    def ground_truth_mesh(self) -> bytes | None:
        """None with labels."""
        return None


def _color_folder(source: Path) -> Path:
    """The folder of colour images, whichever name it has."""
    for name in COLOR_FOLDERS:
        if (source / name).is_dir():
            return source / name
    raise ProgroundError(
        f"has none of the folders {', '.join(COLOR_FOLDERS)}",
        where=source,
        todo="give a sequence of Redwood or Open3D, with its colour images in one of them",
    )


def _timed_files(folder: Path, pattern: str) -> list[tuple[int, Path]]:
    """Time and path of each image, in the order of their numbers.

    A name has microseconds after the number, or the number counts frames.
    """
    timed = []
    for number, path in numbered_files(folder, pattern).items():
        _, _, microseconds = path.stem.partition("-")
        stamp_ns = frame_stamp_ns(number, FRAME_RATE_HZ)
        timed.append((int(microseconds) * 1000 if microseconds else stamp_ns, path))
    return timed


def _only_log(source: Path) -> Path:
    """trajectory.log, else the one file that ends so."""
    if (source / "trajectory.log").is_file():
        return source / "trajectory.log"
    logs = sorted(source.glob("*.log"))
    if len(logs) != 1:
        names = ", ".join(path.name for path in logs) or "none"
        raise ProgroundError(
            f"has no trajectory.log, and not one other .log ({names})",
            where=source,
            todo="pass the file of poses as `trajectory`",
        )
    return logs[0]


def _read_log(path: Path, *, images: int) -> dict[int, np.ndarray]:
    """Poses [4, 4] by the image's place in the sequence."""
    lines = [
        (number, line)
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line.strip()
    ]
    poses: dict[int, np.ndarray] = {}
    for start in range(0, len(lines), 5):
        number, head = lines[start]
        where = f"{path}:{number}"
        try:
            image = int(head.split()[0])
        except ValueError as error:
            raise ProgroundError(
                "does not begin a pose with the number of its image",
                where=where,
                todo="mend the line: a pose is a line of three numbers and four rows of four",
            ) from error
        if image in poses or not 0 <= image < images:
            what = "has two poses" if image in poses else f"is not one of {images} depth images"
            raise ProgroundError(
                f"image {image} {what}",
                where=where,
                todo="give the images and the trajectory of one and the same sequence",
            )
        rows = " ".join(line for _, line in lines[start + 1 : start + 5])
        poses[image] = parse_pose(rows, where=where)
    return poses


def _read_camera(source: Path) -> Camera:
    """The camera of camera_intrinsic.json, as Open3D writes it; else the data set's."""
    path = source / "camera_intrinsic.json"
    if not path.is_file():
        return CAMERA
    try:
        content = read_json(path)
        # By way of a float, for 1e999999999 has too many digits.
        width, height = int(float(content["width"])), int(float(content["height"]))
        matrix = np.array(content["intrinsic_matrix"], dtype=np.float64).reshape(3, 3).T
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise ProgroundError(
            f"does not describe the camera ({error!r})",
            where=path,
            todo=f"it needs {INTRINSIC_EXAMPLE}",
        ) from error
    (fx, skew, cx), (_, fy, cy), _ = matrix.tolist()
    if not (np.isfinite(matrix).all() and min(fx, fy, width, height) > 0 and skew == 0):
        raise ProgroundError(
            "sizes and focal lengths have to be above 0, and axes perpendicular",
            where=path,
            todo=f"mend the file: {INTRINSIC_EXAMPLE}",
        )
    return Camera.from_integer_centres(width, height, fx, fy, cx, cy)
