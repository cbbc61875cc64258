"""Every command on every format: a log needs no option that its data set answers itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from proground_log.camera import Camera, quaternion_from_pose
from proground_log.frame import SensorFrame
from proground_log.log.reader import LogReader
from recorders.formats.icl_nuim import CAMERA as ICL_NUIM
from recorders.formats.seven_scenes import DEPTH_CAMERA
from recorders.reading.images import encoded_png
from recorders.registry import FORMATS
from recorders.room import RoomSource
from recorders.room.source import CAMERA
from tests.commands import Pglog
from tests.writers.arkitscenes import small_frame, write_video
from tests.writers.colmap import write_depth_maps, write_workspace
from tests.writers.hm3dsem_walk import write_walk
from tests.writers.icl_nuim import write_trajectory
from tests.writers.nerfstudio import write_data_set
from tests.writers.redwood import write_sequence as write_redwood
from tests.writers.replica_semantic import semantic_frame
from tests.writers.replica_semantic import write_sequence as write_replica_semantic
from tests.writers.ros1_bag import write_bag
from tests.writers.ros_bags import room_messages, write_mcap
from tests.writers.scannet import true_names, with_things, write_label_table
from tests.writers.scannet import write_scene as write_scannet
from tests.writers.scannet_sens import room_sens
from tests.writers.scannetpp import iphone_frame, poses_of, write_iphone

pytestmark = pytest.mark.slow

KINECT = Camera(640, 480, 535.4, 539.2, 320.6, 248.1)
"""That of freiburg3."""
HABITAT = Camera(640, 480, 320.0, 320.0, 320.0, 240.0)
"""That of Semantic-NeRF's renderer and of the walks."""
REPLAY = ("--max-frames", 3, "--hold-out-every", 3, "--steps", 2, "--keyframe-every", 1)
QUIET = ("--telemetry.no-enabled",)
OPTIONS: dict[str, tuple[object, ...]] = {
    "replica-semantic": (*QUIET, "--simulated"),
    # Every third frame has another camera.
    "arkitscenes": ("--telemetry.view-width", 40, "--telemetry.mesh-voxel-m", 0.2),
}
"""How a log is mapped; for most without a recording for the viewer."""

Write = Callable[[Path, RoomSource, list[SensorFrame]], Path]


def seen_by(camera: Camera, frame: SensorFrame) -> SensorFrame:
    """The room's frame through the lens of a data set that has one camera for all."""
    rays = camera.directions.reshape(-1, 3).astype(np.float64)
    pixels = CAMERA.project(rays).reshape(camera.height, camera.width, 2) - 0.5
    columns, rows = np.moveaxis(pixels.astype(np.float32), -1, 0)
    near = [
        None if image is None else cv2.remap(image, columns, rows, cv2.INTER_NEAREST)
        for image in (frame.depth, frame.labels, frame.instances)
    ]
    color = cv2.remap(frame.decode_color(), columns, rows, cv2.INTER_LINEAR)
    assert near[0] is not None
    return replace(
        frame,
        color=encoded_png(color),
        color_format="png",
        depth=near[0],
        labels=near[1],
        instances=near[2],
    )


def seven_scenes(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    folder.mkdir()
    for number, frame in enumerate(frames):
        frame = seen_by(DEPTH_CAMERA, frame)
        stem = f"frame-{number:06d}"
        (folder / f"{stem}.color.png").write_bytes(frame.color)
        (folder / f"{stem}.depth.png").write_bytes(encoded_depth(frame.depth))
        np.savetxt(folder / f"{stem}.pose.txt", frame.world_from_camera)
    return folder


def tum(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    folder = folder / "rgbd_dataset_freiburg3_room"
    poses = []
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for number, frame in enumerate(frames):
        frame = seen_by(KINECT, frame)
        (folder / f"rgb/{number}.png").write_bytes(frame.color)
        (folder / f"depth/{number}.png").write_bytes(encoded_depth(frame.depth * np.uint16(5)))
        numbers = (*frame.world_from_camera[:3, 3], *quaternion_from_pose(frame.world_from_camera))
        poses.append(f"{number / 10} {' '.join(map(str, numbers))}\n")
    for name in ("rgb", "depth"):
        lines = [f"{number / 10} {name}/{number}.png\n" for number in range(len(frames))]
        (folder / f"{name}.txt").write_text("".join(lines))
    (folder / "groundtruth.txt").write_text("".join(poses))
    return folder


def icl_nuim(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    write_trajectory(folder, [seen_by(ICL_NUIM, frame) for frame in frames])
    return folder


def replica(folder: Path, room: RoomSource, frames: list[SensorFrame]) -> Path:
    for name in ("results", "semantic_class"):
        (folder / name).mkdir(parents=True)
    camera = {"w": 320, "h": 240, "fx": 200, "fy": 200, "cx": 159.5, "cy": 119.5, "scale": 1000}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    classes = [{"id": label, "name": name} for label, name in room.label_names.items()]
    (folder / "info_semantic.json").write_text(json.dumps({"classes": classes}))
    poses = [frame.world_from_camera.ravel() for frame in frames]
    np.savetxt(folder / "traj.txt", poses)
    for number, frame in enumerate(frames):
        (folder / f"results/frame{number:06d}.jpg").write_bytes(frame.color)
        (folder / f"results/depth{number:06d}.png").write_bytes(encoded_depth(frame.depth))
        cv2.imwrite(str(folder / f"semantic_class/semantic_class_{number}.png"), frame.labels)
    return folder


def replica_semantic(folder: Path, room: RoomSource, frames: list[SensorFrame]) -> Path:
    semantic = [semantic_frame(seen_by(HABITAT, frame)) for frame in frames]
    return write_replica_semantic(folder, semantic, room.label_names)


def scannet_sens(folder: Path, room: RoomSource, frames: list[SensorFrame]) -> Path:
    folder.mkdir()
    return room_sens(folder / "scene0000_00.sens", room, frames)


def scannet(folder: Path, room: RoomSource, frames: list[SensorFrame]) -> Path:
    folder.mkdir()
    write_label_table(folder, true_names(room))
    return write_scannet(folder / "scene0000_00", room, with_things(frames))


def scannetpp(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    return write_iphone(folder, [iphone_frame(f) for f in frames], poses_of(frames, CAMERA))


def hm3dsem_walk(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    return write_walk(folder, with_things([seen_by(HABITAT, frame) for frame in frames]))


def record3d(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    pytest.importorskip("lzfse")
    from tests.writers.record3d import members_of, metadata_of, write_zip

    folder.mkdir()
    metadata = metadata_of(frames, CAMERA)
    metadata["perFrameIntrinsicCoeffs"] = [[200.0 + i, 200, 160, 120] for i in range(len(frames))]
    return write_zip(folder / "room.r3d", members_of(frames), metadata)


def arkitscenes(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    write_video(folder, [small_frame(frame) for frame in frames], CAMERA)
    return folder


def nerfstudio(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    folder.mkdir()
    write_data_set(folder, frames)
    return folder


def redwood(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    write_redwood(folder, frames)
    return folder


def colmap(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    write_workspace(folder, frames, CAMERA)
    write_depth_maps(folder, frames, "geometric")
    return folder


def ros2_bag(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    folder.mkdir()
    return write_mcap(folder / "room.mcap", room_messages(frames, CAMERA))


def ros1_bag(folder: Path, _: RoomSource, frames: list[SensorFrame]) -> Path:
    folder.mkdir()
    return write_bag(folder / "room.bag", room_messages(frames, CAMERA))


DATA_SETS: dict[str, Write] = {
    write.__name__.replace("_", "-"): write
    for write in (
        *(seven_scenes, tum, icl_nuim, replica, replica_semantic, scannet_sens, scannet),
        *(scannetpp, hm3dsem_walk, record3d, arkitscenes, nerfstudio, redwood, colmap),
        *(ros2_bag, ros1_bag),
    )
}


def encoded_depth(pixels: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", pixels)[1].tobytes())


def test_every_format_is_here() -> None:
    assert DATA_SETS.keys() == {name for name, each in FORMATS.items() if each.takes_source}


@pytest.mark.parametrize("name", DATA_SETS)
def test_every_command_does_its_work(
    name: str, pglog: Pglog, room: RoomSource, room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    source = DATA_SETS[name](tmp_path / "data set", room, room_frames)
    log, saved, sheet = (tmp_path / file for file in ("a.mcap", "saved.mcap", "sheet.png"))
    recorded = pglog("record", "auto", source, "-o", log)
    assert recorded.code == 0, recorded.err
    assert f": {name}, since it" in recorded.err
    info = json.loads(pglog("info", log, "--json", "--sheet", sheet).out)
    assert (info["format"], info["frames"]) == (name, len(LogReader(log)))
    assert min(cv2.imread(str(sheet)).shape[:2]) > 200
    assert pglog("check", log).code == 0
    assert pglog("recover", log, "-o", saved).code == 0
    assert_same_frames(log, saved)
    # A model of COLMAP alone has no scale.
    assert recorded.err.count("warning") == (name == "colmap")

    run = tmp_path / "run"
    options = OPTIONS.get(name, QUIET)
    replayed = pglog("replay", log, "-o", run, *REPLAY, *options, "--device", "cpu")
    assert replayed.code == 0, replayed.err
    assert (run / "map.safetensors").is_file()
    assert (run / "telemetry.rrd").is_file() == (options[0] not in QUIET)


def assert_same_frames(first: Path, second: Path) -> None:
    pairs = zip(LogReader(first).frames(), LogReader(second).frames(), strict=True)
    for one, other in pairs:
        assert bytes(one.color) == bytes(other.color)
        assert one.stamp_ns == other.stamp_ns
        assert one.calibration == other.calibration
        np.testing.assert_array_equal(one.depth, other.depth)
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
        np.testing.assert_array_equal(one.labels, other.labels)
        np.testing.assert_array_equal(one.instances, other.instances)
