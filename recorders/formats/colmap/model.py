"""COLMAP's sparse models: cameras, images and points3D, each a .bin or a .txt.

Poses are camera_from_world with quaternions w x y z; pixel centres lie at +0.5. Models of COLMAP
3.12 and later have rigs and frames beside these files, but their images keep whole poses too.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.camera import Camera, pose_from_quaternion, transform
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from recorders.formats.colmap.lens import camera_of, parameter_count
from recorders.reading.association import UNIT_TOLERANCE, read_text
from recorders.reading.names import is_inside

MODEL_PARTS = ("cameras", "images", "points3D")
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I4d3dI")
_POINT = struct.Struct("<Q3d3BdQ")
_TRACK_ELEMENT_BYTES = 8
_OBSERVATION = np.dtype([("xy", "<f8", (2,)), ("point", "<i8")])
_NO_POINT = -1


@dataclass(frozen=True, eq=False)
class ModelImage:
    """A registered image and the points that it sees.

    Args:
        name: its path in the folder of images, parts joined by "/".
        camera: its camera.
        lens: how well that fits the model's, where it is not exactly that; else "".
        camera_from_world: float64 [4, 4], in the model's unit.
        pixels: where its points were found, float64 [N, 2].
        points: these points in the camera's axes and the model's unit, float64 [N, 3].
    """

    name: str
    camera: Camera
    lens: str
    camera_from_world: np.ndarray
    pixels: np.ndarray
    points: np.ndarray


def is_model(folder: Path) -> bool:
    """Whether a folder has a model's three files, binary or text."""
    return any(
        all((folder / f"{part}{suffix}").is_file() for part in MODEL_PARTS)
        for suffix in (".bin", ".txt")
    )


def find_model(source: Path, number: int | None) -> Path:
    """The folder of the model: the source itself, its sparse/, or a numbered one in there.

    Args:
        source: a workspace or a model.
        number: which of the numbered models; may be None where there is but one.

    Raises:
        ProgroundError: there is none, or several and no number.
    """
    if number is None:
        for folder in (source, source / "sparse"):
            if is_model(folder):
                return folder
    sparse = source / "sparse"
    inside = sparse.iterdir() if sparse.is_dir() else ()
    models = {int(p.name): p for p in inside if p.name.isdecimal() and is_model(p)}
    names = ", ".join(str(name) for name in sorted(models))
    if not models:
        raise ProgroundError(
            "has no COLMAP model (cameras, images and points3D, .bin or .txt)",
            where=source,
            todo="give a workspace with sparse/ or sparse/0, or the model's own folder",
        )
    if number is None and len(models) > 1:
        raise ProgroundError(
            f"has several models ({names})", where=sparse, todo="choose one with --model"
        )
    chosen = min(models) if number is None else number
    if chosen not in models:
        raise ProgroundError(f"has no model {chosen}", where=sparse, todo=f"choose one of {names}")
    return models[chosen]


def read_model(folder: Path) -> list[ModelImage]:
    """Read a model, from its binary files where it has both kinds.

    Returns:
        The images in the order of the file.

    Raises:
        ProgroundError: a file is missing or broken, or a lens cannot be expressed.
    """
    binary = all((folder / f"{part}.bin").is_file() for part in MODEL_PARTS)
    suffix = ".bin" if binary else ".txt"
    read_cameras = _binary_cameras if binary else _text_cameras
    read_points = _binary_points if binary else _text_points
    read_images = _binary_images if binary else _text_images
    cameras = dict(read_cameras(folder / f"cameras{suffix}"))
    rows = sorted(read_points(folder / f"points3D{suffix}"))
    ids = np.array([key for key, _ in rows], dtype=np.int64)
    points = np.array([xyz for _, xyz in rows], dtype=np.float64).reshape(-1, 3)
    images = []
    for where, name, numbers, camera_id, pixels, seen in read_images(folder / f"images{suffix}"):
        _require_inside(name, where=where)
        pose = _camera_from_world(numbers, where=where)
        observed = seen != _NO_POINT
        at = np.searchsorted(ids, seen[observed])
        known = np.isin(seen[observed], ids)
        for fault, what in (
            (camera_id not in cameras, f"its camera {camera_id} is not in cameras{suffix}"),
            (not known.all(), f"it sees points that points3D{suffix} does not have"),
            (not np.isfinite(pixels).all(), "it has pixels that are not finite"),
            (not np.isfinite(points[at[known]]).all(), "it sees points that are not finite"),
        ):
            if fault:
                raise _broken(what, where=where)
        seen_points = transform(pose, points[at])
        images.append(ModelImage(name, *cameras[camera_id], pose, pixels[observed], seen_points))
    return images


def _broken(what: str, *, where: object) -> ProgroundError:
    return ProgroundError(what, where=where, todo="export or copy the model again")


def _require_inside(name: str, *, where: object) -> None:
    """Raise a ProgroundError unless a name stays within the folder of images."""
    if not is_inside(name):
        raise _broken(f"the image's name {name!r} leads out of the folder of images", where=where)


def _camera_from_world(numbers: np.ndarray, *, where: object) -> np.ndarray:
    """The 4x4 matrix of qw qx qy qz tx ty tz."""
    norm = np.linalg.norm(numbers[:4])
    if not np.isfinite(numbers).all() or abs(norm - 1) > UNIT_TOLERANCE:
        raise _broken("its pose is not of finite numbers with a unit quaternion", where=where)
    return pose_from_quaternion(numbers[4:], np.roll(numbers[:4], -1))


class _Cursor:
    """Reads a binary file from its start; what it gives is never longer than the file."""

    def __init__(self, path: Path) -> None:
        self.path, self._at = path, 0
        self._data = require_file(path).read_bytes()

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        """The next values."""
        return layout.unpack_from(self._data, self._advance(layout.size))

    def array(self, dtype: np.dtype[Any] | str, count: int) -> np.ndarray:
        """The next `count` items."""
        size = count * np.dtype(dtype).itemsize
        return np.frombuffer(self._data, dtype, count, self._advance(size))

    def text(self) -> str:
        """The next text, up to a zero byte."""
        end = self._data.find(b"\0", self._at)
        start = self._advance(end + 1 - self._at)
        try:
            return self._data[start:end].decode()
        except UnicodeDecodeError as error:
            raise _broken("has an image's name that is not text", where=self.path) from error

    def skip(self, size: int) -> None:
        """Pass over some bytes."""
        self._advance(size)

    def _advance(self, size: int) -> int:
        start = self._at
        if not 0 <= size <= len(self._data) - start:
            raise _broken("the file is cut short or damaged", where=self.path)
        self._at += size
        return start


_CameraRow = tuple[int, tuple[Camera, str]]
"""Its number, the camera, and how well it fits."""


def _binary_cameras(path: Path) -> Iterator[_CameraRow]:
    cursor = _Cursor(path)
    for _ in range(cursor.unpack(_COUNT)[0]):
        key, number, width, height = cursor.unpack(_CAMERA)
        where = f"{path}, camera {key}"
        params = cursor.array("<f8", parameter_count(number, where=where)).tolist()
        yield key, camera_of(number, width, height, params, where=where)


def _binary_points(path: Path) -> Iterator[tuple[int, tuple[float, ...]]]:
    cursor = _Cursor(path)
    for _ in range(cursor.unpack(_COUNT)[0]):
        key, x, y, z, *_, track_length = cursor.unpack(_POINT)
        cursor.skip(track_length * _TRACK_ELEMENT_BYTES)
        if key >= 2**63:
            raise _broken(f"{key} cannot be a point's number", where=path)
        yield key, (x, y, z)


_ImageRow = tuple[str, str, np.ndarray, int, np.ndarray, np.ndarray]
"""Where it is, name, pose [7], camera, pixels [N, 2] and points' numbers [N]."""


def _binary_images(path: Path) -> Iterator[_ImageRow]:
    cursor = _Cursor(path)
    for _ in range(cursor.unpack(_COUNT)[0]):
        _, *pose, camera_id = cursor.unpack(_IMAGE)
        name = cursor.text()
        seen = cursor.array(_OBSERVATION, cursor.unpack(_COUNT)[0])
        where = f"{path}, image {name!r}"
        yield where, name, np.array(pose), camera_id, seen["xy"], seen["point"]


def _parsed(fields: list[str], kind: type, *, where: object) -> np.ndarray:
    """The numbers, float64 or int64, that texts say."""
    try:
        return np.array([kind(field) for field in fields], np.int64 if kind is int else np.float64)
    except (ValueError, OverflowError) as error:
        raise _broken("has a column that is not a number", where=where) from error


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Every line and where it is, comments left out, empty ones kept."""
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.lstrip().startswith("#"):
            yield f"{path}:{number}", line.strip()


def _columns(path: Path, least: int) -> Iterator[tuple[str, list[str]]]:
    """The columns of every line that has any."""
    for where, line in _lines(path):
        fields = line.split()
        if fields and len(fields) < least:
            raise _broken(f"has {len(fields)} columns, not {least} or more", where=where)
        if fields:
            yield where, fields


def _text_cameras(path: Path) -> Iterator[_CameraRow]:
    for where, (key, model, width, height, *params) in _columns(path, 4):
        whole = _parsed([key, width, height], int, where=where).tolist()
        numbers = _parsed(params, float, where=where).tolist()
        yield whole[0], camera_of(model, whole[1], whole[2], numbers, where=where)


def _text_points(path: Path) -> Iterator[tuple[int, tuple[float, ...]]]:
    for where, (key, *fields) in _columns(path, 8):
        xyz = _parsed(fields[:3], float, where=where).tolist()
        yield int(_parsed([key], int, where=where)[0]), tuple(xyz)


def _text_images(path: Path) -> Iterator[_ImageRow]:
    """Two lines an image, of which the second may be empty: an image that sees no points."""
    lines = _lines(path)
    for where, line in lines:
        if not line:
            continue
        fields = line.split(maxsplit=9)
        if len(fields) != 10:
            raise _broken(f"has {len(fields)} columns, not 10", where=where)
        below, seen = next(lines, (where, ""))
        columns = seen.split()
        if len(columns) % 3:
            raise _broken("has columns that are not x, y and point in turn", where=below)
        xy = [_parsed(columns[each::3], float, where=below) for each in (0, 1)]
        points = _parsed(columns[2::3], int, where=below)
        pose = _parsed(fields[1:8], float, where=where)
        camera_id = int(_parsed([fields[8]], int, where=where)[0])
        yield where, fields[9], pose, camera_id, np.stack(xy, axis=1), points
