from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from proground_log.camera import pose_from_quaternion
from proground_log.errors import ProgroundError
from recorders.formats.ros.tf_tree import TfTree, Transforms

GAP_NS = 1000


def place(x: float = 0.0, yaw_deg: float = 0.0, norm: float = 1.0) -> Any:
    """A geometry_msgs/Transform."""
    quaternion = norm * Rotation.from_euler("z", yaw_deg, degrees=True).as_quat()
    axes = ("x", "y", "z", "w")
    return SimpleNamespace(
        translation=SimpleNamespace(x=x, y=0.0, z=0.0),
        rotation=SimpleNamespace(**dict(zip(axes, quaternion.tolist(), strict=True))),
    )


def matrix(x: float = 0.0, yaw_deg: float = 0.0) -> np.ndarray:
    quaternion = Rotation.from_euler("z", yaw_deg, degrees=True).as_quat()
    return pose_from_quaternion(np.array([x, 0.0, 0.0]), quaternion)


def tree(transforms: Transforms) -> TfTree:
    return TfTree(transforms.edges(GAP_NS, where="bag"), where="bag")


@pytest.fixture
def robot() -> Transforms:
    transforms = Transforms()
    for stamp_ns, x in ((0, 0.0), (1000, 1.0), (5000, 2.0)):
        transforms.add("map", "odom", stamp_ns, place(x))
    for stamp_ns, yaw_deg in ((500, 0.0), (900, 40.0), (1500, 90.0)):
        transforms.add("/odom", "/base", stamp_ns, place(3.0, yaw_deg))
    transforms.add("base", "left", 7, place(0.1), is_static=True)
    transforms.add("base", "right", 7, place(-0.1), is_static=True)
    return transforms


def test_a_path_is_the_product_of_its_edges_interpolated(robot: Transforms) -> None:
    path = tree(robot).path("map", "left")
    expected = matrix(0.7) @ matrix(3.0, 20.0) @ matrix(0.1)
    np.testing.assert_allclose(path.at([700]), [expected], atol=1e-12)
    back = tree(robot).path("left", "map").at([700])
    np.testing.assert_allclose(back, [np.linalg.inv(expected)], atol=1e-12)
    assert not path.is_static


def test_a_path_between_siblings_goes_over_their_parent(robot: Transforms) -> None:
    path = tree(robot).path("left", "right")
    assert path.is_static
    assert path.covers([10**18]).all()
    np.testing.assert_allclose(path.at([0]), [matrix(-0.2)], atol=1e-12)
    np.testing.assert_array_equal(tree(robot).path("left", "left").at([0, 1]), [np.eye(4)] * 2)


def test_a_time_is_covered_where_all_edges_are(robot: Transforms) -> None:
    path = tree(robot).path("map", "base")
    # Before odometry begins; at its first; within; over map's gap; after odometry.
    np.testing.assert_array_equal(
        path.covers([499, 500, 950, 1200, 1600]), [False, True, True, False, False]
    )
    with pytest.raises(ProgroundError, match=r"bag, map -> odom: there is no pose"):
        path.at([1200])


def test_what_tf2_leaves_out_is_left_out(robot: Transforms) -> None:
    before = tree(robot).path("map", "left").at([700])
    robot.add("map", "odom", 600, place(np.nan))
    robot.add("map", "odom", 601, place(9.0, norm=0.0))
    robot.add("map", "odom", 602, place(9.0, norm=2.0))
    robot.add("base", "base", 603, place(9.0))
    robot.add("", "base", 604, place(9.0))
    robot.add("map", "odom", 1000, place(9.0))  # The first one of a time counts.
    assert robot.left_out == 5
    np.testing.assert_array_equal(tree(robot).path("map", "left").at([700]), before)


def test_the_order_of_sending_does_not_matter() -> None:
    found = []
    for order in ([0, 1, 2], [2, 0, 1]):
        transforms = Transforms()
        for i in order:
            transforms.add("map", "base", 400 * i, place(float(i * i)))
        found.append(tree(transforms).path("map", "base").at([100, 600]))
    np.testing.assert_array_equal(*found)


def test_a_mount_sent_again_and_again_is_static() -> None:
    transforms = Transforms()
    for stamp_ns in (0, 10**9):
        transforms.add("base", "camera", stamp_ns, place(0.1, 30))
    assert tree(transforms).path("base", "camera").is_static
    transforms.add("base", "camera", 2 * 10**9, place(0.2, 30))
    assert not tree(transforms).path("base", "camera").is_static


def test_frames_that_are_not_connected_are_named(robot: Transforms) -> None:
    robot.add("elsewhere", "tag", 0, place(), is_static=True)
    frames = tree(robot)
    assert frames.connects("map", "left")
    assert not frames.connects("map", "tag")
    with pytest.raises(ProgroundError, match=r"'left' to 'tag'.*frames: base, elsewhere, left,"):
        frames.path("tag", "left")
    with pytest.raises(ProgroundError, match="'nowhere' to 'map'"):
        frames.path("map", "nowhere")
    with pytest.raises(ProgroundError, match="none at all"):
        TfTree([], where="bag").path("map", "camera")


def test_the_root_is_the_frame_without_a_parent(robot: Transforms) -> None:
    assert tree(robot).root_above("left") == "map"
    assert tree(robot).root_above("alone") == "alone"
    robot.add("truth", "base", 0, place(), is_static=True)
    with pytest.raises(ProgroundError, match=r"hangs from several \(map, truth\)"):
        tree(robot).root_above("left")


def test_an_edge_takes_the_place_of_its_child_s(robot: Transforms) -> None:
    poses = Transforms()
    poses.add("world", "base", 0, place(7.0), is_static=True)
    (edge,) = poses.edges(GAP_NS, where="bag")
    frames = tree(robot).placed(edge)
    np.testing.assert_allclose(frames.path("world", "left").at([10**9]), [matrix(7.1)], atol=1e-12)
    assert not frames.connects("map", "left")
