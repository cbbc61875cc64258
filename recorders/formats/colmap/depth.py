"""Depth for COLMAP's images: maps by patch match, images of a sensor, or the model's own points.

A depth map is a text header `width&height&channels&` and float32 z row by row, little endian;
0 and below mean nothing. It belongs to the undistorted image of the same name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from proground_log.files import require_file
from recorders.formats.colmap.model import ModelImage
from recorders.formats.colmap.scale import pixels_inside
from recorders.reading.images import COPY_AGAIN, read_depth

_HEADER = re.compile(rb"(\d{1,6})&(\d{1,6})&(\d{1,6})&")
_LONGEST_HEADER = 32
KINDS = ("geometric", "photometric")
"""Of depth maps, the better one first: photometric ones were not made consistent."""
INVALID_DEPTH_MM = 65535
"""Kinect recordings write it where nothing was measured; no sensor reaches 65 m."""


def find_depth_maps(folder: Path, names: Sequence[str]) -> tuple[str, dict[str, Path]]:
    """The better kind of depth maps in a folder, and the map of each image that has one.

    None at all: a workspace has the folder before patch match was run.
    """
    for kind in KINDS:
        paths = {name: folder / f"{name}.{kind}.bin" for name in names}
        found = {name: path for name, path in paths.items() if path.is_file()}
        if found:
            return kind, found
    return "", {}


def depth_map_camera(path: Path, camera: Camera) -> Camera:
    """The camera of a depth map: the image's, scaled where patch match ran on smaller images.

    Raises:
        ProgroundError: the file is no depth map, is not whole, or is of another view.
    """
    width, height, _ = _read_header(path)
    if width > camera.width or abs(camera.height * width / camera.width - height) > 1:
        raise ProgroundError(
            f"is {width}x{height}, but the undistorted image is {camera.width}x{camera.height}",
            where=path,
            todo="take stereo/, sparse/ and images/ from one `colmap image_undistorter`",
        )
    return camera.resized(width, height)


def read_depth_map(path: Path) -> np.ndarray:
    """Read a depth map, float32 [H, W] in the model's unit, 0 = nothing.

    Raises:
        ProgroundError: the file is no depth map, or is not whole.
    """
    width, height, start = _read_header(path)
    with path.open("rb") as stream:
        stream.seek(start)
        data = stream.read(4 * width * height)
    depth = np.frombuffer(data, "<f4").reshape(height, width)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


def _read_header(path: Path) -> tuple[int, int, int]:
    """Width, height and where the depth starts; the file's size is as these say."""
    size = require_file(path).stat().st_size
    with path.open("rb") as stream:
        match = _HEADER.match(stream.read(_LONGEST_HEADER))
    if match is None or int(match[3]) != 1 or not (int(match[1]) and int(match[2])):
        raise ProgroundError("is not a depth map of COLMAP", where=path, todo=COPY_AGAIN)
    width, height = int(match[1]), int(match[2])
    if size - match.end() != 4 * width * height:
        raise ProgroundError(
            f"has {size} bytes, which are not those of {width}x{height} pixels",
            where=path,
            todo=COPY_AGAIN,
        )
    return width, height, match.end()


def last_number(name: str) -> int | None:
    """The last number in a file's name, its suffix left out; None where there is none."""
    match = re.search(r"(\d+)\D*$", PurePosixPath(name).stem)
    return int(match[1]) if match and len(match[1]) <= 18 else None


def find_depth_images(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """The depth PNG of each image that has one: of the same name, or else the same number.

    Of the PNGs in the folder only those count whose name has "depth", where any has it.

    Raises:
        ProgroundError: there is none, or two files have the same number.
    """
    if not folder.is_dir():
        raise ProgroundError("no such folder", where=folder, todo="check --depth")
    namesakes = {name: folder / str(PurePosixPath(name).with_suffix(".png")) for name in names}
    found = {name: path for name, path in namesakes.items() if path.is_file()}
    if not found:
        files = sorted(path.name for path in folder.iterdir() if path.suffix.lower() == ".png")
        depths = _by_number([f for f in files if "depth" in f.lower()] or files, where=folder)
        images = _by_number(names, where="the model's images")
        found = {images[n]: folder / depths[n] for n in sorted(images.keys() & depths.keys())}
    if not found:
        raise ProgroundError(
            "has no PNG with the name or the number of an image in the model",
            where=folder,
            todo="name the depth images as the colour images, such as 0001.png for 0001.jpg",
        )
    return found


def _by_number(names: Sequence[str], *, where: object) -> dict[int, str]:
    found: dict[int, str] = {}
    for name in names:
        number = last_number(name)
        if number in found:
            raise ProgroundError(
                f"{name} has the same number as {found[number]}",
                where=where,
                todo="name the depth images as the colour images, such as 0001.png for 0001.jpg",
            )
        if number is not None:
            found[number] = name
    return found


def read_sensor_depth(path: Path, camera: Camera) -> np.ndarray:
    """A depth PNG, uint16 [H, W] in millimetres; raises as `read_depth`."""
    depth = read_depth(path, camera)
    depth[depth == INVALID_DEPTH_MM] = 0
    return depth


def sparse_depth(image: ModelImage) -> np.ndarray:
    """Depth of the model's points where the image saw them, float32 units [H, W], else 0.

    Where several points fall into one pixel, the nearest counts.
    """
    rows, columns, inside = pixels_inside(image.pixels, image.camera)
    z = image.points[inside, 2]
    depth = np.full((image.camera.height, image.camera.width), np.inf, dtype=np.float32)
    np.minimum.at(depth, (rows[z > 0], columns[z > 0]), z[z > 0].astype(np.float32))
    depth[np.isinf(depth)] = 0
    return depth
