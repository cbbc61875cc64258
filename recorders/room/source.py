"""The built-in room as a source of sensor frames."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.streams import stream
from recorders.room.geometry import Grid, grid_points, pack
from recorders.room.layout import furnish
from recorders.room.light import bake
from recorders.room.mesh import seen_mesh
from recorders.room.noise import noisy_color, noisy_depth
from recorders.room.path import camera_poses
from recorders.room.render import look, paint
from recorders.room.scene import LABEL_NAMES, RoomObject

CAMERA = Camera(width=320, height=240, fx=200.0, fy=200.0, cx=160.0, cy=120.0)
"""77 degrees wide."""

PERIOD_NS = 100_000_000
JPEG_QUALITY = 95
MESH_VIEWS = 30
"""About how many of the frames decide what the ground-truth mesh shows: every fourth of 120."""


class RoomSource:
    """A furnished room that needs no data set; `frame(i)` depends on the seed and `i` alone.

    Args:
        seed: varies colours, placement within centimetres, the camera's way and the noise;
            0 <= seed < 2**64.
        frames: how many frames to spread evenly over the camera's closed way.
        noise: whether depth and colour are those of a Kinect-like sensor rather than exact.

    Raises:
        ProgroundError: a seed or number of frames out of range.
    """

    name: str = "synthetic"

    def __init__(self, *, seed: int = 0, frames: int = 120, noise: bool = False) -> None:
        if not 0 <= seed < 2**64:
            raise ProgroundError(
                f"the seed is {seed}", where="synthetic", todo="choose one from 0 to 2**64 - 1"
            )
        if frames < 1:
            raise ProgroundError(
                f"{frames} frames are asked for", where="synthetic", todo="ask for 1 or more"
            )
        self._seed, self._noise = seed, noise
        self._scene = furnish(seed)
        self._geometry = pack(self._scene)
        self._poses = camera_poses(seed, frames)
        self.calibration = Calibration.registered(CAMERA)
        self.label_names: dict[int, str] = dict(LABEL_NAMES)
        self.notes = {"seed": str(seed), "sensor noise": "yes" if noise else "no"}
        self.warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def objects(self) -> tuple[RoomObject, ...]:
        """Everything in the room, by instance number."""
        return self._scene.objects

    def frame(self, index: int) -> SensorFrame:
        """Frame `index`: JPEG colour, depth in whole millimetres, class of every pixel."""
        if not 0 <= index < len(self):
            raise ProgroundError(
                f"there is no frame {index}",
                where="synthetic",
                todo=f"choose one from 0 to {len(self) - 1}",
            )
        pose = self._poses[index]
        view = look(self._geometry, CAMERA, pose)
        color = paint(self._geometry, self._light, CAMERA, pose, view)
        depth_m = view.depth_m
        if self._noise:
            depth_m = noisy_depth(depth_m, view.rays, stream(self._seed, "depth noise", index))
            color = noisy_color(color, stream(self._seed, "color noise", index))
        labels = np.append(self._scene.labels, np.uint16(0))[view.bodies]
        return SensorFrame(
            index=index,
            stamp_ns=index * PERIOD_NS,
            color_stamp_ns=index * PERIOD_NS,
            color=_jpeg(color),
            color_format="jpeg",
            depth=np.round(depth_m * 1000.0).astype(np.uint16),
            world_from_camera=pose.copy(),
            labels=labels,
        )

    def ground_truth_mesh(self) -> bytes:
        """The surface that the frames saw, with classes, instances and views; see `seen_mesh`."""
        stride = max(1, len(self) // MESH_VIEWS)
        return seen_mesh(
            self._geometry,
            self._grid,
            self._light,
            CAMERA,
            self._poses[::stride],
            self._scene.labels,
            self._scene.instances,
        )

    @cached_property
    def _grid(self) -> Grid:
        return grid_points(self._geometry)

    @cached_property
    def _light(self) -> np.ndarray:
        """Computed at the first frame: opening the room for its objects alone stays quick."""
        return bake(self._geometry, self._grid)


def _jpeg(color: np.ndarray) -> bytes:
    bgr = np.ascontiguousarray(color[..., ::-1])
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(encoded.tobytes())
