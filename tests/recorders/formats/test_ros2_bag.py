from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType

from proground_log.camera import Camera, pose_from_quaternion
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.log import messages
from recorders.formats.ros.messages import camera, color_image
from recorders.formats.ros.ros2_bag import Ros2BagSource
from recorders.registry import FORMATS
from recorders.room import RoomSource
from tests.round_trip import assert_round_trip
from tests.writers.ros_bags import (
    COLOR_FRAME,
    COLOR_LATER_NS,
    DEPTH_FRAME,
    IMAGE,
    INFO,
    ODOMETRY,
    POSE,
    START_NS,
    Sent,
    cdr,
    depth_message,
    odometry,
    pose,
    raw_image,
    room_messages,
    transform,
    write_mcap,
)

METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  relative_file_paths:
    - bag_0.mcap
    - "bag_1.mcap"
  compression_format: ""
  compression_mode: "{mode}"
"""


@pytest.fixture(scope="session")
def sent(room: RoomSource, room_frames: list[SensorFrame]) -> list[Sent]:
    return room_messages(room_frames, room.calibration.depth)


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory, sent: list[Sent]) -> Path:
    return write_mcap(tmp_path_factory.mktemp("bags") / "bag.mcap", sent)


def test_a_bag_comes_back_exactly(
    bag: Path, room: RoomSource, room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    source = Ros2BagSource(bag)
    assert_round_trip(source, room_frames, tmp_path / "log.mcap")
    assert source.calibration == room.calibration
    assert source.label_names == {}
    assert source.ground_truth_mesh() is None
    assert source.warnings == ()
    assert source.notes == {
        "colour": "/camera/color/image_raw/compressed",
        "depth": "/camera/depth/image_rect_raw",
        "poses": f"of {DEPTH_FRAME} in map, by tf",
        "images without a partner": "0",
        "images with the time of another": "0",
        "frames without a pose": "0",
        "transforms that are none": "0",
    }
    frame = source.frame(3)
    assert (frame.index, frame.stamp_ns) == (3, START_NS + room_frames[3].stamp_ns)
    assert frame.color_stamp_ns == frame.stamp_ns + COLOR_LATER_NS
    assert frame.depth.dtype == np.uint16


@pytest.mark.parametrize("color", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_raw_colour_keeps_its_pixels(
    color: str, room: RoomSource, room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    sent = room_messages(room_frames[:2], room.calibration.depth, color=color)
    source = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", sent))
    assert_round_trip(source, room_frames[:2], tmp_path / "log.mcap", same_bytes=False)
    assert source.frame(0).color_format == "png"


@pytest.mark.parametrize(
    ("depth", "dtype", "atol_m"),
    [
        ("16UC1", np.uint16, 0),
        ("mono16", np.uint16, 0),
        ("big 16UC1", np.uint16, 0),
        ("png", np.uint16, 0),
        ("16UC1; compressedDepth png", np.uint16, 0),
        ("16UC1; compressedDepth rvl", np.uint16, 0),
        ("32FC1", np.float32, 0),
        ("big 32FC1", np.float32, 0),
        # One step of the coded inverse, 1/10100 of 1/m, at the room's largest depth.
        ("32FC1; compressedDepth png", np.float32, 6**2 / 10100),
        ("32FC1; compressedDepth rvl", np.float32, 6**2 / 10100),
    ],
)
def test_depth_of_all_encodings(
    depth: str,
    dtype: type,
    atol_m: float,
    room: RoomSource,
    room_frames: list[SensorFrame],
    tmp_path: Path,
) -> None:
    expected = room_frames[:2]
    if depth.endswith("32FC1"):
        # These pixels hold what is not a number, infinite and negative.
        expected = [
            SensorFrame(**{**vars(frame), "depth": frame.depth.copy()}) for frame in expected
        ]
        for frame in expected:
            frame.depth[0, :3] = 0
    sent = room_messages(room_frames[:2], room.calibration.depth, depth=depth)
    source = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", sent))
    assert source.frame(0).depth.dtype == dtype
    assert_round_trip(source, expected, tmp_path / "log.mcap", depth_atol_m=atol_m)


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.NONE])
def test_chunks_of_all_compressions(
    compression: CompressionType, sent: list[Sent], bag: Path, tmp_path: Path
) -> None:
    other = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", sent, compression=compression))
    np.testing.assert_array_equal(other.frame(2).depth, Ros2BagSource(bag).frame(2).depth)


def test_big_endian_cdr_is_read(sent: list[Sent], bag: Path, tmp_path: Path) -> None:
    def encode(its_type: str, message: Any) -> bytes:
        if its_type != INFO:
            return cdr(its_type, message)
        little, data = cdr(its_type, message), bytearray()
        # Swapping a CameraInfo by hand: two words of time, then strings and doubles by place.
        data += b"\0\0\0\0" + little[4:8][::-1] + little[8:12][::-1]
        return bytes(data) + swapped_rest(little[12:])

    infos = [each for each in sent if each[1] == INFO]
    other = [(t, k, n, m) for t, k, n, m in sent if k != INFO] + infos
    source = Ros2BagSource(
        write_mcap(tmp_path / "bag.mcap", sorted(other, key=lambda each: each[2]), encode=encode)
    )
    assert source.calibration == Ros2BagSource(bag).calibration


def swapped_rest(rest: bytes) -> bytes:
    """What follows the time in a little-endian CameraInfo, the other way round."""
    out, at = bytearray(), 0

    def take(size: int, times: int = 1) -> None:
        nonlocal at
        # Alignment counts from behind the encapsulation; the time takes eight bytes.
        padding = -(at + 8) % size
        out.extend(rest[at : at + padding])
        at += padding
        for _ in range(times):
            out.extend(rest[at : at + size][::-1])
            at += size

    def string() -> None:
        nonlocal at
        take(4)
        length = int.from_bytes(rest[at - 4 : at], "little")
        out.extend(rest[at : at + length])
        at += length

    string()
    take(4, 2)
    string()
    take(4)
    take(8, int.from_bytes(rest[at - 4 : at], "little") + 9 + 9 + 12)
    take(4, 2 + 4)
    take(1)
    return bytes(out)


def test_a_folder_of_several_files_is_one_bag(
    sent: list[Sent], room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    half = len(sent) // 2
    write_mcap(tmp_path / "bag_0.mcap", sent[:half])
    write_mcap(tmp_path / "bag_1.mcap", sent[half:])
    (tmp_path / "metadata.yaml").write_text(METADATA.format(mode=""))
    source = Ros2BagSource(tmp_path)
    assert_round_trip(source, room_frames, tmp_path / "log.mcap")
    assert FORMATS["ros2-bag"].recognise(tmp_path) == "has rosbag2's metadata.yaml"
    (tmp_path / "bag_1.mcap").unlink()
    with pytest.raises(ProgroundError, match=r"bag_1\.mcap: no such file"):
        Ros2BagSource(tmp_path)
    (tmp_path / "metadata.yaml").write_text(METADATA.format(mode="FILE"))
    with pytest.raises(ProgroundError, match=r"compressed the bag once more; .*ros2 bag convert"):
        Ros2BagSource(tmp_path)
    (tmp_path / "metadata.yaml").write_text("relative_file_paths:\n  - bag_0.db3\n")
    with pytest.raises(ProgroundError, match=r"has no MCAP files; .*ros2 bag convert"):
        Ros2BagSource(tmp_path)
    (tmp_path / "metadata.yaml").unlink()
    with pytest.raises(ProgroundError, match=r"has no metadata.yaml; .*ros2 bag reindex"):
        Ros2BagSource(tmp_path)


def test_frames_are_the_same_from_several_threads(bag: Path) -> None:
    source = Ros2BagSource(bag)
    one_by_one = [source.frame(index) for index in range(len(source))]
    with ThreadPoolExecutor(4) as executor:
        order = [5, 0, 3, 1, 4, 2] * 3
        for index, frame in zip(order, executor.map(source.frame, order), strict=True):
            assert frame.color == one_by_one[index].color
            np.testing.assert_array_equal(frame.depth, one_by_one[index].depth)


def test_the_mount_of_the_colour_camera_is_of_tf(
    room: RoomSource, room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    mount = pose_from_quaternion(np.array([0.015, 0.001, 0.0]), np.array([0.0, 0.02, 0.0, 0.9998]))
    sent = room_messages(room_frames, room.calibration.depth, depth_from_color=mount)
    source = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", sent))
    np.testing.assert_allclose(source.calibration.depth_from_color, mount, atol=1e-9)
    given = Ros2BagSource(tmp_path / "bag.mcap", calibration=room.calibration)
    assert given.calibration == room.calibration


def test_images_in_one_frame_are_registered(sent: list[Sent], tmp_path: Path) -> None:
    def in_depth_frame(each: Sent) -> Sent:
        topic, its_type, stamp_ns, message = each
        if topic.startswith("/camera/color"):
            message = SimpleNamespace(**{**vars(message)})
            message.header = SimpleNamespace(stamp=message.header.stamp, frame_id=DEPTH_FRAME)
        return topic, its_type, stamp_ns, message

    source = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", map(in_depth_frame, sent)))
    assert source.calibration.is_registered
    assert "registered" in source.notes


def test_frames_without_pose_or_partner_are_counted(sent: list[Sent], tmp_path: Path) -> None:
    depth_times = sorted({t for topic, _, t, _ in sent if topic == "/camera/depth/image_rect_raw"})
    color_times = sorted({t for topic, _, t, _ in sent if topic.endswith("compressed")})
    kept = [
        each
        for each in sent
        if not (each[0] == "/tf" and each[2] in (depth_times[0], depth_times[-1]))
        and not (each[0].endswith("compressed") and each[2] == color_times[2])
    ]
    source = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", [*kept, kept[-1]]))
    assert [source.frame(i).stamp_ns for i in range(len(source))] == [
        depth_times[i] for i in (1, 3, 4)
    ]
    assert source.notes["images without a partner"] == "1"
    assert source.notes["frames without a pose"] == "2"
    assert source.notes["images with the time of another"] == "1"


def test_poses_are_interpolated_within_the_gap(sent: list[Sent], tmp_path: Path) -> None:
    depth_times = sorted({t for topic, _, t, _ in sent if topic == "/camera/depth/image_rect_raw"})
    kept = [each for each in sent if each[0] != "/tf" or each[2] != depth_times[2]]
    path = write_mcap(tmp_path / "bag.mcap", kept)
    whole = Ros2BagSource(path)
    assert len(whole) == 6
    before, at, after = (whole.frame(i).world_from_camera[:3, 3] for i in (1, 2, 3))
    np.testing.assert_allclose(at, (before + after) / 2, atol=2e-3)
    strict = Ros2BagSource(path, max_pose_gap_s=0.15)
    assert (len(strict), strict.notes["frames without a pose"]) == (5, "1")


def test_pairs_are_within_the_time_asked_for(bag: Path) -> None:
    with pytest.raises(ProgroundError, match=r"bag\.mcap: no frame: 6 depth and 6 .* 0 pairs"):
        Ros2BagSource(bag, max_time_difference_s=0.003)


@pytest.mark.parametrize("world_frame", ["odom", "base_link"])
def test_the_world_frame_is_the_one_asked_for(bag: Path, world_frame: str) -> None:
    source = Ros2BagSource(bag, world_frame=world_frame)
    assert f"in {world_frame}" in source.notes["poses"]
    first, last = source.frame(0).world_from_camera, source.frame(5).world_from_camera
    assert np.allclose(first, last) == (world_frame == "base_link")
    moved = [] if world_frame == "odom" else [f"nothing moves between base_link and {DEPTH_FRAME}"]
    assert list(source.warnings) == moved


def test_another_world_frame_is_an_error_that_names_the_frames(bag: Path) -> None:
    frames = "base_link, camera_color_optical_frame, camera_depth_optical_frame, camera_link, map"
    with pytest.raises(ProgroundError, match=f"to 'moon'; .*frames: {frames}"):
        Ros2BagSource(bag, world_frame="moon")


def test_without_map_odom_is_the_world_and_else_the_root(sent: list[Sent], tmp_path: Path) -> None:
    def renamed(old: str, new: str) -> list[Sent]:
        out = []
        for topic, its_type, stamp_ns, message in sent:
            if topic == "/tf":
                parent = message.transforms[0].header.frame_id
                if parent == "map":
                    continue
                if parent == old:
                    each = message.transforms[0]
                    message = transform(np.eye(4), stamp_ns, new, "base_link")[3]
                    message.transforms[0].transform = each.transform
            out.append((topic, its_type, stamp_ns, message))
        return out

    for name in ("odom", "vicon"):
        path = write_mcap(tmp_path / f"{name}.mcap", renamed("odom", name))
        assert f"in {name}," in Ros2BagSource(path).notes["poses"]


def test_odometry_takes_the_place_of_tf(
    sent: list[Sent], room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    # tf has nothing but the mounts; odometry says where base_link is in the room.
    for frame in room_frames:
        stamp_ns = START_NS + frame.stamp_ns
        sent = [*sent, ("/odom", ODOMETRY, stamp_ns, odometry(frame))]
    path = write_mcap(tmp_path / "bag.mcap", sent)
    source = Ros2BagSource(path, odometry_topic="/odom")
    assert_round_trip(source, room_frames, tmp_path / "log.mcap")
    assert source.notes["poses"] == f"of {DEPTH_FRAME} in odom, by /odom"


def test_a_pose_without_a_child_is_of_the_depth_camera(
    sent: list[Sent], room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    sent = [each for each in sent if each[0] != "/tf"]
    for frame in room_frames:
        stamp_ns = START_NS + frame.stamp_ns
        message = SimpleNamespace(
            header=messages.header(stamp_ns, "mocap"), pose=pose(frame.world_from_camera)
        )
        sent.append(("/mocap/pose", POSE, stamp_ns, message))
    path = write_mcap(tmp_path / "bag.mcap", sent)
    source = Ros2BagSource(path, odometry_topic="/mocap/pose")
    assert_round_trip(source, room_frames, tmp_path / "log.mcap")
    with pytest.raises(ProgroundError, match=r"no messages of /pose; .* there are: /mocap/pose"):
        Ros2BagSource(path, odometry_topic="/pose")


def test_several_topics_of_a_kind_are_listed(
    sent: list[Sent], room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    more = []
    for topic, its_type, stamp_ns, message in sent:
        more.append((topic, its_type, stamp_ns, message))
        if topic.startswith("/camera/depth"):
            more.append((topic.replace("/camera/", "/other/"), its_type, stamp_ns, message))
        if topic == "/camera/depth/image_rect_raw":
            # The same image by another transport, and an infrared one: these leave no doubt.
            name = "16UC1; compressedDepth png"
            coded = depth_message(room_frames[0], name)[2]
            more.append((f"{topic}/compressedDepth", "sensor_msgs/msg/CompressedImage", 5, coded))
            grey = raw_image(np.zeros((240, 320), np.uint8), "mono8", stamp_ns, COLOR_FRAME)
            more.append(("/camera/infra1/image_rect_raw", IMAGE, stamp_ns, grey))
    path = write_mcap(tmp_path / "bag.mcap", more)
    both = "/camera/depth/image_rect_raw, /other/depth/image_rect_raw; choose one with depth_topic"
    with pytest.raises(ProgroundError, match=f"several topics of depth images: {both}") as caught:
        Ros2BagSource(path)
    assert caught.value.where == str(path)
    source = Ros2BagSource(path, depth_topic="/other/depth/image_rect_raw")
    assert source.notes["colour"] == "/camera/color/image_raw/compressed"


def test_missing_topics_are_named(sent: list[Sent], tmp_path: Path) -> None:
    def without(text: str) -> Path:
        return write_mcap(tmp_path / "bag.mcap", [each for each in sent if text not in each[0]])

    path = without("depth/image")
    with pytest.raises(ProgroundError, match=r"no topic of depth .* are: /camera/color/image_raw/"):
        Ros2BagSource(path)
    path = without("depth/camera_info")
    missing = r"/camera/depth/camera_info; choose with depth_info_topic; there are: /camera/color/"
    with pytest.raises(ProgroundError, match=missing):
        Ros2BagSource(path)
    assert len(Ros2BagSource(path, depth_info_topic="/camera/color/camera_info")) == 6
    path = without("/tf")
    with pytest.raises(ProgroundError, match=r"no transforms lead from .*none at all"):
        Ros2BagSource(path)
    with pytest.raises(ProgroundError, match="not known as depth"):
        Ros2BagSource(without("nothing"), depth_topic="/camera/color/image_raw/compressed")


def test_an_image_of_another_size_than_its_camera_is_refused(
    sent: list[Sent], room: RoomSource, tmp_path: Path
) -> None:
    small = messages.camera_info(Camera(160, 120, 100, 100, 80, 60), START_NS, "x")
    for sensor in ("color", "depth"):
        topic = f"/camera/{sensor}/camera_info"
        changed = [(t, k, n, small if t == topic else m) for t, k, n, m in sent]
        path = write_mcap(tmp_path / "bag.mcap", changed)
        with pytest.raises(ProgroundError, match=f"{sensor}.* 320x240, its camera 160x120"):
            Ros2BagSource(path)
        assert len(Ros2BagSource(path, calibration=room.calibration)) == 6


def test_a_camera_that_changes_is_warned_of(sent: list[Sent], tmp_path: Path) -> None:
    other = messages.camera_info(Camera(320, 240, 201, 200, 160, 120), START_NS, COLOR_FRAME)
    changed = [*sent, ("/camera/color/camera_info", INFO, sent[-1][2], other)]
    source = Ros2BagSource(write_mcap(tmp_path / "bag.mcap", changed))
    assert source.warnings == (
        "the camera of /camera/color/camera_info changes on the way; its first state was taken",
    )
    assert source.calibration.color.fx == 200


def info(**changes: Any) -> Any:
    lens = Camera.from_integer_centres(
        640, 480, 600, 601, 319.5, 239.5, (0.1, -0.2, 1e-3, 2e-3, 0.3)
    )
    message: Any = messages.camera_info(lens, START_NS, "camera")
    message.p = [500.0, 0, 310, 0, 0, 502, 230, 0, 0, 0, 1, 0]
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_a_rectified_camera_is_p_and_a_raw_one_k_and_d() -> None:
    raw = camera(info(), is_rectified=False, where="info")
    assert (raw.fx, raw.fy, raw.cx, raw.cy) == (600, 601, 320, 240)
    assert raw.distortion == (0.1, -0.2, 1e-3, 2e-3, 0.3)
    rectified = camera(info(), is_rectified=True, where="info")
    assert rectified == Camera(640, 480, 500, 502, 310.5, 230.5)
    # Nobody filled P in: of such a camera K is all there is.
    assert camera(info(p=[0.0] * 12), is_rectified=True, where="info") == raw


@pytest.mark.parametrize(
    ("model", "terms", "expected"),
    [
        ("plumb_bob", [0.0] * 5, ()),
        ("", [], ()),
        ("none", [], ()),
        ("plumb_bob", [0.1, 0.2, 0.3, 0.4], (0.1, 0.2, 0.3, 0.4, 0.0)),
        ("rational_polynomial", [0.1] * 8, (0.1,) * 8),
        ("rational_polynomial", [0.1] * 8 + [0.0] * 6, (0.1,) * 8),
        ("equidistant", [0.1] * 4, (0.1,) * 4),
        ("plumb_bob", [0.1] * 8, None),
        ("rational_polynomial", [0.1] * 12, None),
        ("equidistant", [0.0] * 4, None),
        ("double_sphere", [0.1], None),
        ("plumb_bob", [np.nan] * 5, None),
    ],
)
def test_lenses(model: str, terms: list[float], expected: tuple[float, ...] | None) -> None:
    message = info(distortion_model=model, d=terms)
    if expected is None:
        with pytest.raises(ProgroundError, match=f"info: a lens of the model '{model}'"):
            camera(message, is_rectified=False, where="info")
    else:
        assert camera(message, is_rectified=False, where="info").distortion == expected


def test_binning_and_regions_change_the_camera() -> None:
    roi = SimpleNamespace(x_offset=100, y_offset=40, height=400, width=500, do_rectify=False)
    found = camera(info(binning_x=2, binning_y=4, roi=roi), is_rectified=False, where="info")
    assert (found.width, found.height) == (250, 100)
    assert (found.fx, found.fy, found.cx, found.cy) == (300, 601 / 4, 110, 50)


@pytest.mark.parametrize("changes", [{"k": [0.0] * 9}, {"width": 0}, {"height": 2**31}])
def test_a_camera_that_was_not_calibrated_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ProgroundError, match="info: is no calibrated camera"):
        camera(info(**changes), is_rectified=False, where="info")


def test_bayer_yuv_and_grey_become_rgb() -> None:
    def rgb(pixels: np.ndarray, encoding: str) -> np.ndarray:
        image = color_image(raw_image(pixels, encoding, 0, ""), where="here")
        frame = SensorFrame(0, 0, 0, image.data, image.format, np.empty(0), np.eye(4))
        return frame.decode_color()

    red = np.zeros((8, 8), np.uint8)
    red[0::2, 0::2] = 200
    np.testing.assert_array_equal(rgb(red, "bayer_rggb8")[4, 4], [200, 0, 0])
    np.testing.assert_array_equal(rgb(red, "bayer_bggr8")[4, 4], [0, 0, 200])
    np.testing.assert_array_equal(rgb(red.T, "mono8")[2, 2], [200, 200, 200])
    # Y is 235 everywhere and U and V are neutral: white, in both orders.
    uyvy = np.tile(np.array([128, 235], np.uint8), (4, 4)).reshape(4, 4, 2)
    assert (rgb(uyvy, "yuv422") > 250).all()
    assert (rgb(uyvy[..., ::-1], "yuv422_yuy2") > 250).all()
    with pytest.raises(ProgroundError, match="here: images of the encoding '8UC3' are not known"):
        rgb(np.zeros((2, 2, 3), np.uint8), "8UC3")
    cut = raw_image(red, "mono8", 0, "")
    cut.data = cut.data[:-1]
    with pytest.raises(ProgroundError, match="here: 63 bytes in rows of 8 make no 8x8 image"):
        color_image(cut, where="here")


def test_our_own_logs_are_recognised_to_be_refused(room_log: Path) -> None:
    assert FORMATS["ros2-bag"].recognise(room_log) == "is MCAP with ROS 2 images"
    with pytest.raises(ProgroundError, match=r"room\.mcap: is a log of pglog already"):
        Ros2BagSource(room_log)


def test_recognise(bag: Path, tmp_path: Path, sent: list[Sent]) -> None:
    assert FORMATS["ros2-bag"].recognise(bag) == "is MCAP with ROS 2 images"
    others = write_mcap(tmp_path / "tf.mcap", [each for each in sent if "tf" in each[0]])
    text = tmp_path / "text.mcap"
    text.write_text("no bag")
    (tmp_path / "cut.mcap").write_bytes(bag.read_bytes()[:-100])
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("a: 1\n")
    for path in (others, text, tmp_path / "cut.mcap", folder, tmp_path, tmp_path / "nothing"):
        assert FORMATS["ros2-bag"].recognise(path) is None
    assert FORMATS["ros2-bag"].recognise(Path("x" * 5000 + ".mcap")) is None


def test_bags_without_an_index_can_be_mended(bag: Path, sent: list[Sent], tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    path.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    with pytest.raises(ProgroundError, match=r"bag\.mcap: the bag is cut off.*mcap recover"):
        Ros2BagSource(path)
    write_mcap(path, sent, use_chunking=False)
    with pytest.raises(ProgroundError, match=r"bag\.mcap: the bag has no index.*mcap recover"):
        Ros2BagSource(path)
    path.write_bytes(b"")
    with pytest.raises(ProgroundError, match="is no MCAP file"):
        Ros2BagSource(path)
    with pytest.raises(ProgroundError, match=r"bag\.db3: is SQLite.*ros2 bag convert"):
        Ros2BagSource(tmp_path / "bag.db3")


@pytest.mark.parametrize("has_checksums", [True, False])
def test_a_damaged_bag_gives_an_error_or_what_it_held(
    has_checksums: bool, room: RoomSource, room_frames: list[SensorFrame], tmp_path: Path
) -> None:
    rng = np.random.default_rng(8)
    sent = room_messages(room_frames[:2], room.calibration.depth)
    compression = CompressionType.ZSTD if has_checksums else CompressionType.NONE
    path = write_mcap(
        tmp_path / "bag.mcap", sent, compression=compression, enable_crcs=has_checksums
    )
    whole, right = path.read_bytes(), Ros2BagSource(path).frame(1)
    errors = 0
    for number in range(120):
        data = bytearray(whole)
        # Where there is least to hit, at both ends, is where most hangs on it.
        span = len(data) if number % 2 else 6000
        for at in rng.integers(0, span, 1 if has_checksums else 4):
            data[-at if number % 4 else at] ^= 1 << rng.integers(8)
        path.write_bytes(data if number % 8 else data[: rng.integers(len(data))])
        try:
            source = Ros2BagSource(path)
            found = source.frame(len(source) - 1)
        except ProgroundError:
            errors += 1
            continue
        if has_checksums:
            assert found.color == right.color
            np.testing.assert_array_equal(found.depth, right.depth)
            np.testing.assert_array_equal(found.world_from_camera, right.world_from_camera)
    assert errors > 20


def test_a_chunk_that_would_fill_the_memory_is_refused(bag: Path, tmp_path: Path) -> None:
    data = bytearray(bag.read_bytes())
    # The first chunk's record: opcode and length, times, then the size unpacked.
    at = data.index(b"\x06", 8 + 9)
    while int.from_bytes(data[at + 1 : at + 9], "little") > len(data) or data[at] != 6:
        at = data.index(b"\x06", at + 1)
    data[at + 25 : at + 33] = (2**40).to_bytes(8, "little")
    path = tmp_path / "bag.mcap"
    path.write_bytes(data)
    with pytest.raises(ProgroundError, match=r"bag\.mcap: .*damaged.*1099511627776 bytes"):
        Ros2BagSource(path)
