"""COLMAP: a reconstruction from images, with depth of its own or of a sensor.

A workspace has images/ and a sparse model (sparse/ or sparse/0); a dense one, written by
`colmap image_undistorter`, has undistorted images and stereo/depth_maps beside its model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from recorders.formats.colmap.depth import (
    depth_map_camera,
    find_depth_images,
    find_depth_maps,
    last_number,
    read_depth_map,
    read_sensor_depth,
    sparse_depth,
)
from recorders.formats.colmap.model import ModelImage, find_model, is_model, read_model
from recorders.formats.colmap.scale import Scale, View, scale_from_depth, scale_from_distances
from recorders.reading.association import frame_stamp_ns
from recorders.reading.images import EncodedImage, read_encoded
from recorders.reading.natural_order import natural_key

FRAME_RATE_HZ = 30
LAST_NUMBER = 10**9
"""Greater numbers in names are not frame numbers."""
POOR_RESIDUAL = 0.1
"""A Kinect's depth leaves 2 %, that of images 1.3 s away 11 %, of images far away some 25 %."""
SPARSE = "the model's points only"
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


def recognise(source: Path) -> str | None:
    """Why the path looks like a COLMAP workspace or model; None where it does not."""
    for name in ("", "sparse", "sparse/0"):
        if is_model(source / name if name else source):
            return f"has a COLMAP model{f' in {name}' if name else ''}"
    return None


@dataclass(frozen=True, eq=False)
class _Depth:
    """Where one image's depth is: the frame's cameras, and how to read it.

    What is read is uint16 in millimetres or float32 in the model's unit.
    """

    calibration: Calibration
    read: Callable[[], np.ndarray]


class ColmapSource:
    """One model; frames are in the natural order of the images' names."""

    name = "colmap"

    def __init__(
        self,
        source: Path,
        *,
        calibration: Calibration | None = None,
        images: Path | None = None,
        depth: Path | None = None,
        model: int | None = None,
        scale: float | None = None,
        distances: Path | None = None,
    ) -> None:
        """Read the model, find the images and their depth, and settle the scale.

        Args:
            source: the workspace, or a model's folder.
            calibration: with `depth`, the depth camera and where it sits; the colour cameras
                remain the model's. By default depth is registered to colour.
            images: the folder of the model's images; by default images/ in the workspace.
            depth: a folder of depth PNGs, uint16 millimetres, named or numbered as the images;
                by default stereo/depth_maps, and without these the model's points.
            model: which of several models in sparse/.
            scale: metres a unit of the model.
            distances: a text file, `image image metres` a line: known distances between cameras.

        Raises:
            ProgroundError: model or images are missing or broken, images are not the model's,
                or there is no depth where it was said to be.
        """
        _require_options_agree(calibration, depth, scale, distances)
        folder = find_model(source, model)
        registered = sorted(read_model(folder), key=lambda image: natural_key(image.name))
        if not registered:
            raise ProgroundError("has no images", where=folder, todo="choose another model")
        images = images or source / "images"
        if not images.is_dir():
            raise ProgroundError("no such folder", where=images, todo="pass --images")
        for image in registered:
            if not (images / image.name).is_file():
                raise ProgroundError(
                    "no such file, though the model has the image",
                    where=images / image.name,
                    todo="pass the folder that COLMAP was run on with --images",
                )
        if depth is not None:
            kind, found = "images of a sensor", _sensor_depth(registered, depth, calibration)
        else:
            kind, found = _depth_of_its_own(registered, source / "stereo" / "depth_maps")
        self._images = [image for image in registered if image.name in found]
        self._depth = [found[image.name] for image in self._images]
        self._paths = [images / image.name for image in self._images]
        self._stamps_ns, times = _stamps_ns([image.name for image in self._images])
        self.calibration = self._depth[0].calibration
        self.label_names: dict[int, str] = {}
        self.notes = {
            "depth": kind,
            "times": times,
            "frames without a pose": str(_unregistered(registered, images)),
            "frames without depth": str(len(registered) - len(self._images)),
        }
        fits = sorted({image.lens for image in self._images if image.lens})
        if fits:
            self.notes["lens"] = "; ".join(fits)
        self.warnings: tuple[str, ...] = ()
        if kind == SPARSE:
            self.warnings += ("there are no depth maps: depth is that of the model's points only",)
        self._metres_per_unit = 1.0
        # One frame of each camera, so that images of another size are found now.
        cameras = [image.camera for image in self._images]
        for camera in dict.fromkeys(cameras):
            self.frame(cameras.index(camera))
        self._settle_scale(registered, depth, scale, distances)

    def __len__(self) -> int:
        return len(self._images)

    def frame(self, index: int) -> SensorFrame:
        """Read frame `index`; its depth is a sensor's in uint16 millimetres, or float32 metres."""
        image, depth, stamp_ns = self._images[index], self._depth[index], self._stamps_ns[index]
        color = _read_color(self._paths[index], image.camera)
        pixels = depth.read()
        if pixels.dtype == np.float32:
            pixels = pixels * np.float32(self._metres_per_unit)
        world_from_color = np.linalg.inv(image.camera_from_world)
        world_from_color[:3, 3] *= self._metres_per_unit
        color_from_depth = np.linalg.inv(depth.calibration.depth_from_color)
        return SensorFrame(
            index=index,
            stamp_ns=stamp_ns,
            color_stamp_ns=stamp_ns,
            color=color.data,
            color_format=color.format,
            depth=pixels,
            world_from_camera=world_from_color @ color_from_depth,
            calibration=None if depth.calibration == self.calibration else depth.calibration,
        )

    def ground_truth_mesh(self) -> bytes | None:
        """COLMAP has none."""
        return None

    def _settle_scale(
        self,
        registered: Sequence[ModelImage],
        depth: Path | None,
        given: float | None,
        distances: Path | None,
    ) -> None:
        """Set the scale, and say where it comes from."""
        if given is not None:
            scale = Scale(given, 0.0, f"{given:.5g} m a unit, as given")
        elif distances is not None:
            centres = {
                image.name: np.linalg.inv(image.camera_from_world)[:3, 3] for image in registered
            }
            scale = scale_from_distances(distances, centres)
        elif depth is not None:
            pairs = zip(self._images, self._depth, strict=True)
            views = [View(image.points, each.calibration, each.read) for image, each in pairs]
            scale = scale_from_depth(views, where=depth)
        else:
            scale = Scale(1.0, 0.0, "unknown, one unit is taken for a metre")
            self.warnings += (
                "the reconstruction has no scale: one unit is taken for a metre; pass --scale, "
                "--distances or --depth",
            )
        if scale.residual > POOR_RESIDUAL:
            self.warnings += (f"the scale fits poorly: {scale.note}",)
        self._metres_per_unit = scale.metres_per_unit
        self.notes["scale"] = scale.note


def _require_options_agree(
    calibration: Calibration | None,
    depth: Path | None,
    scale: float | None,
    distances: Path | None,
) -> None:
    for fault, what, todo in (
        (
            calibration is not None and depth is None,
            "a calibration says where a depth camera sits, and there is none",
            "pass --depth too, or leave the calibration out",
        ),
        (
            scale is not None and distances is not None,
            "--scale and --distances both tell the scale",
            "pass one of them",
        ),
        (
            scale is not None and not (math.isfinite(scale) and scale > 0),
            f"a scale of {scale} is not above 0",
            "pass the metres in a unit of the model",
        ),
    ):
        if fault:
            raise ProgroundError(what, where="format colmap", todo=todo)


def _sensor_depth(
    registered: Sequence[ModelImage], folder: Path, rig: Calibration | None
) -> dict[str, _Depth]:
    """A sensor's depth images, by the image's name."""
    paths = find_depth_images(folder, [image.name for image in registered])
    found = {}
    for image in registered:
        if image.name in paths:
            cameras = Calibration.registered(image.camera)
            if rig is not None:
                cameras = Calibration(image.camera, rig.depth, rig.depth_from_color)
            read = partial(read_sensor_depth, paths[image.name], cameras.depth)
            found[image.name] = _Depth(cameras, read)
    return found


def _depth_of_its_own(
    registered: Sequence[ModelImage], folder: Path
) -> tuple[str, dict[str, _Depth]]:
    """What depth it is, and the depth maps by the image's name; without any, the points."""
    kind, paths = find_depth_maps(folder, [image.name for image in registered])
    if not paths:
        return SPARSE, {
            image.name: _Depth(Calibration.registered(image.camera), partial(sparse_depth, image))
            for image in registered
        }
    found = {}
    for image in registered:
        if image.camera.distortion:
            raise ProgroundError(
                "belongs to undistorted images, but the model's camera has distortion",
                where=folder,
                todo="give the workspace that `colmap image_undistorter` wrote, with its sparse/",
            )
        if image.name in paths:
            path = paths[image.name]
            camera = depth_map_camera(path, image.camera)
            cameras = Calibration(image.camera, camera, np.eye(4))
            found[image.name] = _Depth(cameras, partial(read_depth_map, path))
    return f"{kind} depth maps", found


def _stamps_ns(names: Sequence[str]) -> tuple[list[int], str]:
    """Times by the numbers in the names where these ascend, else by the order; and which."""
    numbers = [last_number(name) for name in names]
    known = [n for n in numbers if n is not None and n <= LAST_NUMBER]
    by_number = len(known) == len(names) and all(a < b for a, b in pairwise(known))
    how = "the numbers in the names" if by_number else "the order of the names"
    chosen = known if by_number else range(len(names))
    return [frame_stamp_ns(n, FRAME_RATE_HZ) for n in chosen], f"{FRAME_RATE_HZ} Hz, by {how}"


def _unregistered(registered: Sequence[ModelImage], images: Path) -> int:
    """How many images lie beside those of the model without being in it."""
    paths = {images / image.name for image in registered}
    folders = {path.parent for path in paths}
    beside = {p for f in folders for p in f.iterdir() if p.suffix.lower() in _IMAGE_SUFFIXES}
    return len(beside - paths)


def _read_color(path: Path, camera: Camera) -> EncodedImage:
    """Read a colour file, not decoded; raise a ProgroundError unless it is of the model's size."""
    image = read_encoded(path)
    if (image.width, image.height) != (camera.width, camera.height):
        kinds = ("original", "undistorted") if camera.is_ideal else ("undistorted", "original")
        raise ProgroundError(
            f"is {image.width}x{image.height}, but the model's camera is "
            f"{camera.width}x{camera.height}: these seem to be {kinds[0]} images, and the model "
            f"that of {kinds[1]} ones",
            where=path,
            todo="pass the images of this model with --images",
        )
    return image
