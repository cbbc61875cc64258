"""The built-in room against slow references that share no mathematics with it."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import combinations, pairwise

import numba
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, label

from proground_log.camera import transform
from proground_log.errors import ProgroundError
from recorders.room import RoomObject, RoomSource
from recorders.room.layout import furnish
from recorders.room.mesh import FACE, VERTEX
from recorders.room.path import camera_poses
from recorders.room.scene import Scene
from recorders.room.shapes import BOX, ELLIPSOID, FRUSTUM, Primitive
from recorders.room.shell import ROOM_M
from recorders.source import Source

pytestmark = pytest.mark.slow

FRAMES = 40
SEEDS = range(5)
SHELL = {"wall", "floor", "ceiling"}


@pytest.fixture(scope="module")
def room() -> RoomSource:
    return RoomSource(seed=0, frames=FRAMES)


@pytest.fixture(scope="module")
def mesh(room: RoomSource) -> tuple[np.ndarray, np.ndarray]:
    return read_ply(room.ground_truth_mesh())


@pytest.fixture(scope="module", params=SEEDS)
def scene(request: pytest.FixtureRequest) -> Scene:
    return furnish(request.param)


def read_ply(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    header, _, body = data.partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in header.splitlines() if b"element" in line]
    split = counts[0] * VERTEX.itemsize
    assert len(body) == split + counts[1] * FACE.itemsize
    return np.frombuffer(body[:split], VERTEX), np.frombuffer(body[split:], FACE)


def positions(vertices: np.ndarray) -> np.ndarray:
    return np.stack([vertices["x"], vertices["y"], vertices["z"]], axis=1).astype(np.float64)


def contains(part: Primitive, points_m: np.ndarray, margin_m: float = 0.0) -> np.ndarray:
    """Membership, by the definition of each body; a rectangle is the solid behind it."""
    x, y, z = transform(np.linalg.inv(part.world_from_local), points_m).T
    a, b, c = part.size_m
    m = margin_m
    if part.kind == BOX:
        return (abs(x) <= a - m) & (abs(y) <= b - m) & (abs(z) <= c - m)
    if part.kind == ELLIPSOID:
        return (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 <= (1 - m / min(a, b, c)) ** 2
    if part.kind == FRUSTUM:
        radius = a + (b - a) * (z + c) / (2 * c)
        return (np.hypot(x, y) <= radius - m) & (abs(z) <= c - m)
    return z <= -m


def parts_of(scene: Scene) -> dict[int, list[Primitive]]:
    parts = defaultdict(list)
    for part, instance in zip(scene.primitives, scene.instances, strict=True):
        parts[int(instance)].append(part)
    return parts


def test_is_a_source(room: RoomSource) -> None:
    source: Source = room
    assert len(source) == FRAMES
    assert source.label_names[0] == "nothing"
    frame = source.frame(3)
    assert (frame.stamp_ns, frame.depth.dtype, frame.depth.shape) == (3 * 10**8, "u2", (240, 320))
    assert frame.labels is not None
    assert (frame.labels.dtype, frame.labels.shape) == ("u2", (240, 320))
    assert frame.decode_color().shape == (240, 320, 3)
    for index in (-1, FRAMES):
        with pytest.raises(ProgroundError, match="no frame"):
            source.frame(index)


@pytest.mark.parametrize("options", [{"seed": -1}, {"seed": 2**64}, {"frames": 0}])
def test_options_out_of_range(options: dict[str, int]) -> None:
    with pytest.raises(ProgroundError):
        RoomSource(**options)


def test_depth_and_labels_agree_with_membership(room: RoomSource) -> None:
    """Nothing along the ray before the depth, and a body of the pixel's class just behind it."""
    scene = furnish(0)
    labels = scene.labels
    rng = np.random.default_rng(1)
    for index in rng.choice(FRAMES, 4, replace=False):
        frame = room.frame(int(index))
        assert frame.labels is not None
        rows, columns = rng.integers(0, 240, 12), rng.integers(0, 320, 12)
        depth_m = frame.depth[rows, columns] / 1000.0
        rays = room.calibration.depth.directions[rows, columns].astype(np.float64)
        steps = np.append(np.arange(0.02, 7.5, 0.006)[:, None] + 0 * depth_m, [depth_m + 2e-3], 0)
        before = steps < depth_m - 1e-3
        points = transform(frame.world_from_camera, steps[..., None] * rays)
        behind = np.zeros(12, dtype=bool)
        for part, label_here in zip(scene.primitives, labels, strict=True):
            inside = contains(part, points.reshape(-1, 3)).reshape(steps.shape)
            assert not (inside & before).any()
            behind |= inside[-1] & (label_here == frame.labels[rows, columns])
        # A ray may graze a body so that 2 mm later it is out again.
        assert behind.mean() >= 0.9


def test_neighbouring_frames_agree(room: RoomSource) -> None:
    camera = room.calibration.depth
    for i, j in ((0, 1), (12, 14), (30, 31)):
        first, second = room.frame(i), room.frame(j)
        world = transform(first.world_from_camera, camera.unproject(first.depth_m).reshape(-1, 3))
        there = transform(np.linalg.inv(second.world_from_camera), world.astype(np.float64))
        there = there[there[:, 2] > 0.1]
        uv = camera.project(there) - 0.5
        u, v = np.floor(uv).astype(int).T
        ok = (u >= 0) & (u < 319) & (v >= 0) & (v < 239)
        u, v, uv, z = u[ok], v[ok], uv[ok], there[ok, 2]
        around = np.stack([second.depth_m[v + b, u + a] for b in (0, 1) for a in (0, 1)])
        x, y = uv[:, 0] - u, uv[:, 1] - v
        # On a plane the inverse of the depth is linear in the image.
        weights = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y])
        expected = 1.0 / (weights / around).sum(axis=0)
        visible = (np.ptp(around, axis=0) < 0.05) & (z < expected + 0.05)
        assert visible.sum() > 10_000
        assert np.mean(np.abs(z - expected)[visible] < 0.01) > 0.97


def test_labels_agree_with_the_mesh(room: RoomSource, mesh: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, _ = mesh
    camera = room.calibration.depth
    agreed, compared = 0, 0
    for index in (0, 15, 28):
        frame = room.frame(index)
        assert frame.labels is not None
        local = transform(np.linalg.inv(frame.world_from_camera), positions(vertices))
        front = local[:, 2] > 0.1
        u, v = np.floor(camera.project(np.where(front[:, None], local, 1.0))).astype(int).T
        ok = front & (u >= 1) & (u < 319) & (v >= 1) & (v < 239)
        u, v, z, expected = u[ok], v[ok], local[ok, 2], vertices["label"][ok]
        near = abs(frame.depth_m[v, u] - z) < 0.003
        around = np.stack([frame.labels[v + b, u + a] for b in (-1, 0, 1) for a in (-1, 0, 1)])
        sure = near & (np.ptp(around.astype(int), axis=0) == 0)
        agreed += int((around[4] == expected)[sure].sum())
        compared += int(sure.sum())
    assert compared > 5000
    assert agreed / compared > 0.999


def test_mesh_layout_and_faces(room: RoomSource, mesh: tuple[np.ndarray, np.ndarray]) -> None:
    header = room.ground_truth_mesh().partition(b"end_header\n")[0].decode().splitlines()
    assert header[:2] == ["ply", "format binary_little_endian 1.0"]
    assert [line for line in header if line.startswith("property")] == [
        "property float x",
        "property float y",
        "property float z",
        "property uchar red",
        "property uchar green",
        "property uchar blue",
        "property ushort label",
        "property ushort instance",
        "property ushort n_views",
        "property list uchar int vertex_indices",
    ]
    vertices, faces = mesh
    assert (faces["count"] == 3).all()
    assert (vertices["n_views"] >= 1).all()
    assert vertices["n_views"].max() <= FRAMES
    corners = faces["corners"]
    assert np.array_equal(np.unique(corners), np.arange(len(vertices)))
    assert (np.ptp(vertices["instance"][corners].astype(int), axis=1) == 0).all()
    by_instance = {thing.instance: thing.label for thing in room.objects}
    assert [by_instance[i] for i in vertices["instance"]] == vertices["label"].tolist()
    triangles = positions(vertices)[corners]
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1)
    assert edges.max() < 0.07
    # Each face turns its front to the camera that saw it: some camera is before its plane.
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    eyes = camera_poses(0, FRAMES)[:, :3, 3]
    before = np.einsum("fk,efk->ef", normals, eyes[:, None] - triangles.mean(axis=1)[None])
    assert (before.max(axis=0) > 0).mean() > 0.999


def test_mesh_shows_nearly_every_object(
    room: RoomSource, mesh: tuple[np.ndarray, np.ndarray]
) -> None:
    seen = set(mesh[0]["instance"].tolist())
    missing = [thing for thing in room.objects if thing.instance not in seen]
    assert len(missing) <= 2, missing


def test_frames_depend_on_seed_and_index_alone(room: RoomSource) -> None:
    """Another order, another number of threads, another object: the same bytes."""
    threads = numba.get_num_threads()
    expected = [room.frame(index) for index in (2, 7)]
    mesh = room.ground_truth_mesh()
    numba.set_num_threads(1)
    try:
        again = RoomSource(seed=0, frames=FRAMES)
        found = [again.frame(index) for index in (7, 2)][::-1]
        assert again.ground_truth_mesh() == mesh
    finally:
        numba.set_num_threads(threads)
    for one, other in zip(expected, found, strict=True):
        assert one.color == other.color
        assert one.depth.tobytes() == other.depth.tobytes()
        assert np.array_equal(one.labels, other.labels)
        assert np.array_equal(one.world_from_camera, other.world_from_camera)


def test_noise_is_that_of_the_frame(room: RoomSource) -> None:
    noisy = RoomSource(seed=0, frames=FRAMES, noise=True)
    ninth, eighth = noisy.frame(9), noisy.frame(8)
    again = noisy.frame(8)
    assert (again.color, again.depth.tobytes()) == (eighth.color, eighth.depth.tobytes())
    exact = room.frame(8)
    measured = eighth.depth > 0
    assert 0.005 < 1 - measured.mean() < 0.15
    error = (eighth.depth_m - exact.depth_m)[measured]
    near, far = exact.depth_m[measured] < 2.5, exact.depth_m[measured] > 3.5
    assert abs(np.mean(error)) < 1e-3
    assert np.std(error[far]) > 2 * np.std(error[near]) > 1e-3
    ninth_error = (ninth.depth_m - room.frame(9).depth_m)[measured & (ninth.depth > 0)]
    assert not np.array_equal(ninth_error[:1000], error[:1000])
    assert np.array_equal(eighth.labels, exact.labels)


def test_another_seed_is_another_room() -> None:
    assert furnish(0).objects != furnish(1).objects
    assert not np.allclose(camera_poses(0, 4), camera_poses(1, 4))
    one, other = (Counter(o.class_name for o in furnish(seed).objects) for seed in (0, 1))
    assert one == other


def furniture(scene: Scene) -> list[RoomObject]:
    return [thing for thing in scene.objects if thing.class_name not in SHELL]


def test_rules_of_the_room(scene: Scene) -> None:
    things = furniture(scene)
    counts = Counter(thing.class_name for thing in things)
    assert len(counts) >= 16
    assert counts["chair"] == 4
    assert min(counts["cup"], counts["lamp"], counts["cushion"], counts["book"]) >= 3
    colors = defaultdict(set)
    classes = defaultdict(set)
    for thing in things:
        colors[thing.class_name].add(thing.color_name)
        classes[thing.color_name].add(thing.class_name)
    assert len(colors["chair"]) == 4
    assert len(colors["cushion"]) >= 3
    for other in ("cushion", "cup", "book", "bin"):
        assert colors["chair"] & colors[other]
    assert sum(len(names) > 1 for names in classes.values()) >= 5
    assert [thing.instance for thing in scene.objects] == list(range(1, len(scene.objects) + 1))


def test_everything_is_inside_the_room(scene: Scene) -> None:
    for thing in furniture(scene):
        assert (np.array(thing.lower_m) > -1e-9).all(), thing
        assert (np.array(thing.upper_m) < np.array(ROOM_M) + 1e-9).all(), thing


def test_nothing_interpenetrates(scene: Scene) -> None:
    parts = parts_of(scene)
    for one, other in combinations(furniture(scene), 2):
        overlap = np.minimum(one.upper_m, other.upper_m) - np.maximum(one.lower_m, other.lower_m)
        if overlap.min() <= 2e-3:
            continue
        for a in parts[one.instance]:
            (a_low, a_high) = a.aabb()
            for b in parts[other.instance]:
                b_low, b_high = b.aabb()
                low, high = np.maximum(a_low, b_low), np.minimum(a_high, b_high)
                if (high - low).min() <= 2e-3:
                    continue
                axes = [np.linspace(p, q, 15) for p, q in zip(low, high, strict=True)]
                points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
                both = contains(a, points, 1e-3) & contains(b, points, 1e-3)
                assert not both.any(), (one, other)


def test_nothing_floats(scene: Scene) -> None:
    """Each thing stands on the floor or on another thing, or touches a wall or the ceiling."""
    parts = parts_of(scene)
    boxes = [(i, *part.aabb()) for i, own in parts.items() for part in own]
    owners = np.array([box[0] for box in boxes])
    lower, upper = np.array([box[1] for box in boxes]), np.array([box[2] for box in boxes])
    for thing in furniture(scene):
        on_floor = thing.lower_m[2] < 2e-3
        gaps = [*thing.lower_m[:2], *(np.array(ROOM_M) - thing.upper_m)]
        if on_floor or (
            thing.class_name in {"door", "window", "picture", "lamp"} and min(gaps) < 1e-3
        ):
            continue
        rests = False
        for part in parts[thing.instance]:
            low, high = part.aabb()
            touching = abs(upper[:, 2] - low[2]) < 2e-3
            beside = ((lower[:, :2] < high[:2]) & (upper[:, :2] > low[:2])).all(axis=1)
            rests |= bool((touching & beside & (owners != thing.instance)).any())
        assert rests, thing


def test_a_robot_can_get_about(scene: Scene) -> None:
    """Of radius 0.2 m and 0.6 m high; rugs are no obstacle. It reaches all quarters of the room."""
    cell_m = 0.04
    x, y = np.meshgrid(*(np.arange(cell_m / 2, side, cell_m) for side in ROOM_M[:2]), indexing="ij")
    free = np.ones(x.shape, dtype=bool)
    shell = {thing.instance for thing in scene.objects if thing.class_name in SHELL}
    for part, instance in zip(scene.primitives, scene.instances, strict=True):
        low, high = part.aabb()
        if instance in shell or low[2] > 0.6 or high[2] < 0.02:
            continue
        free &= ~((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]))
    roomy = distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * cell_m > 0.2
    regions, _ = label(roomy)
    largest = regions == np.argmax(np.bincount(regions[roomy]))
    assert largest.sum() * cell_m**2 > 5.0
    for corner in ((1.0, 1.5), (2.4, 3.6), (5.0, 3.0), (1.2, 0.5), (3.9, 3.8)):
        assert largest[int(corner[0] / cell_m), int(corner[1] / cell_m)], corner


@pytest.mark.parametrize("seed", SEEDS)
def test_camera_moves_smoothly_and_keeps_clear(seed: int) -> None:
    poses = camera_poses(seed, 120)
    eyes, rotations = poses[:, :3, 3], poses[:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert (np.linalg.det(rotations) > 0).all()
    around = [*range(120), 0]
    for i, j in pairwise(around):
        cosine = (np.trace(rotations[i].T @ rotations[j]) - 1) / 2
        assert np.degrees(np.arccos(min(1.0, cosine))) < 12.0
        assert np.linalg.norm(eyes[i] - eyes[j]) < 0.2
    assert (eyes[:, 2] > 1.2).all()
    assert (eyes[:, 2] < 1.65).all()
    scene = furnish(seed)
    for thing in furniture(scene):
        nearest = np.clip(eyes, thing.lower_m, thing.upper_m)
        assert np.linalg.norm(eyes - nearest, axis=1).min() > 0.3, thing


def test_any_number_of_frames_goes_all_the_way_round() -> None:
    fine = camera_poses(0, 240)
    assert np.array_equal(camera_poses(0, 60), fine[::4])
    assert len(camera_poses(0, 1)) == 1
