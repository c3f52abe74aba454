"""The ray-cast camera against every triangle of the scene, one by one."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import sapien
from sapien import physx

from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera, View, look_at
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.panda import Panda
from torchgrasp.sim.panda_tables import ARM_SHAPES

OPEN, CLOSED = np.array([0.04, 0.04]), np.array([0.0, 0.0])
# The arm stands behind its base, so that a hand put anywhere before it is seen alone.
AWAY = kin.READY_POSTURE + np.array((2.8, 0, 0, 0, 0, 0, 0))
FAR_AWAY = np.eye(4)
FAR_AWAY[:3, 3] = (50.0, 0.0, 50.0)
# Corners of a unit cube and its triangles, by hand.
CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
CUBE = np.array(
    [
        ((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        ((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
).reshape(12, 3)


def nearest_hit(rays: np.ndarray, triangles: np.ndarray, near: float) -> np.ndarray:
    """(N,) depths beyond `near` at which rays (N, 3) from the origin first meet triangles (F, 3, 3)."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (normal * a).sum(-1) / (rays @ normal.T)  # (N, F)
        hit = depth[..., None] * rays[:, None, :]
        inside = depth > near
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (np.cross(q - p, hit - p) * normal).sum(-1) >= -1e-15
    return np.where(inside, depth, np.inf).min(axis=-1)


def finger_triangles(fingers: np.ndarray) -> np.ndarray:
    """(F, 3, 3) of the simulated robot's fingers and hand, hand frame."""
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    panda = Panda(scene)
    panda.articulation.set_qpos(np.concatenate((kin.READY_POSTURE, fingers)).astype(np.float32))
    hand = panda.articulation.find_link_by_name("hand")
    T_ee_base = np.linalg.inv(hand.entity_pose.to_transformation_matrix())
    out = []
    for name in ("hand", "left_finger", "right_finger"):
        link = panda.articulation.find_link_by_name(name)
        for shape in link.collision_shapes:
            T = T_ee_base @ (link.entity_pose * shape.local_pose).to_transformation_matrix()
            out.append((CORNERS * 2 * shape.half_size @ T[:3, :3].T + T[:3, 3])[CUBE])
    return np.concatenate(out)


def arm_depth(rays: np.ndarray, T_base_camera: np.ndarray, q: np.ndarray, near: float) -> np.ndarray:
    """(N,) depths beyond `near` at which rays meet the arm, by steps of the distance to it."""
    links = np.concatenate((np.eye(4)[None], kin.link_poses(q[None])[0, :7]))
    length = np.linalg.norm(rays, axis=-1)
    nearest = np.full(len(rays), np.inf)
    for link, shapes in zip(links, ARM_SHAPES, strict=True):
        for shape in shapes:
            T = np.linalg.inv(link @ shape.pose) @ T_base_camera
            depth = np.full(len(rays), near)
            inside = distance(T[:3, :3] @ (near * rays).T + T[:3, 3:], shape.size) < 0
            for _ in range(150):
                step = distance(T[:3, :3] @ (depth[:, None] * rays).T + T[:3, 3:], shape.size)
                depth = np.minimum(depth + np.maximum(step, 0.0) / length, 20.0)
            assert not inside.any(), "the steps below begin outside of the arm"
            nearest = np.where((step < 2e-5) & (depth > near), np.minimum(nearest, depth), nearest)
    return nearest


def distance(points: np.ndarray, size: tuple[float, ...]) -> np.ndarray:
    """(N,) signed distances of points (3, N) to a box or capsule about the origin."""
    if len(size) == 3:
        beyond = np.abs(points) - np.array(size)[:, None] / 2
        return np.linalg.norm(np.maximum(beyond, 0.0), axis=0) + np.minimum(beyond.max(axis=0), 0.0)
    radius, length = size
    along = np.clip(points[2], -length / 2, length / 2)
    return np.sqrt(points[0] ** 2 + points[1] ** 2 + (points[2] - along) ** 2) - radius


def reference(camera, target, T_base_ee, T_base_object, fingers, q) -> tuple[np.ndarray, np.ndarray]:
    """Depth and mask by trying every triangle."""
    cam = camera.intrinsics
    focal = cam.height / 2 / np.tan(cam.fov / 2)
    v, u = np.mgrid[: cam.height, : cam.width] + 0.5
    rays = np.stack(((u - cam.width / 2) / focal, (v - cam.height / 2) / focal, np.ones_like(u)), -1)
    rays = rays.reshape(-1, 3)
    T_camera_base = np.linalg.inv(camera.pose(T_base_ee))

    def seen(T, triangles):
        points = triangles @ T[:3, :3].T + T[:3, 3]
        return nearest_hit(rays, points, cam.near)

    x0, x1, y0, y1 = 0.12, 1.12, -0.65, 0.65
    a, b, c, d = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])
    table = seen(T_camera_base, np.array([[a, b, c], [a, c, d]]))
    hand = seen(T_camera_base @ T_base_ee, finger_triangles(fingers))
    robot = np.minimum(hand, arm_depth(rays, camera.pose(T_base_ee), q, cam.near))
    body = seen(T_camera_base @ T_base_object, target.vertices[target.faces].astype(np.float64))
    depth = np.minimum(np.minimum(table, robot), body)
    mask = (body < np.minimum(table, robot)) & (depth <= cam.far)
    depth = np.where(depth <= cam.far, depth, 0.0)
    return depth.reshape(cam.height, cam.width), mask.reshape(cam.height, cam.width)


def pose_at(x: float, y: float, z: float, *, down: bool = False) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return pose @ np.diag([1.0, -1.0, -1.0, 1.0]) if down else pose


def look(camera, target, T_base_ee, T_base_object, fingers, q=AWAY) -> tuple[np.ndarray, np.ndarray]:
    """Depth and mask of one picture."""
    joints = np.concatenate((q, fingers))
    picture = camera.observe(View(target, T_base_object, joints, T_base_ee))
    return picture["depth"], picture["mask"]


def agree(camera, target, T_base_ee, T_base_object, fingers=OPEN, q=AWAY) -> tuple[np.ndarray, np.ndarray]:
    """The picture, after a check that the reference agrees on all but grazing pixels."""
    depth, mask = look(camera, target, T_base_ee, T_base_object, fingers, q)
    expected, expected_mask = reference(camera, target, T_base_ee, T_base_object, fingers, q)
    assert depth.dtype == np.float32 and mask.dtype == bool
    assert depth.shape == mask.shape == (camera.intrinsics.height, camera.intrinsics.width)
    assert (np.abs(depth - expected) > 1e-4).mean() < 0.005
    assert (mask != expected_mask).mean() < 0.005
    return depth, mask


@pytest.mark.parametrize("index", range(4))
def test_pictures_agree_with_every_triangle_tried(index):
    target = ProceduralObjects("train", num_objects=8, num_grasps=100)[2 * index]
    rng = np.random.default_rng(index)
    camera = RaycastCamera(CameraIntrinsics(32, 24))
    marked = 0
    for _ in range(3):
        T_base_object = pose_at(0.64, 0.0, 0.06)
        T_base_object[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        T_base_object[:3, 0] *= np.linalg.det(T_base_object[:3, :3])
        q = kin.READY_POSTURE + rng.uniform(-0.15, 0.15, 7)
        fingers = rng.uniform(0.0, 0.04, 2).round(4)
        marked += agree(camera, target, kin.forward_kinematics(q[None])[0], T_base_object, fingers, q)[
            1
        ].sum()
    assert marked > 40


@pytest.mark.parametrize("place", [{}, {"T_base_camera": look_at((1.4, 0.3, 0.9), (0.4, 0.0, 0.2))}])
def test_the_whole_arm_is_seen_wherever_it_stands(brick, place):
    camera = RaycastCamera(CameraIntrinsics(32, 24, fov=1.2), **place)
    rng = np.random.default_rng(2)
    seen = 0
    for _ in range(12):
        q = rng.uniform(kin.JOINT_LOWER, kin.JOINT_UPPER)
        hand = kin.forward_kinematics(q[None])[0]
        depth, _ = agree(camera, brick, hand, pose_at(0.6, 0.0, 0.04), OPEN, q)
        bare = look(camera, brick, hand, pose_at(0.6, 0.0, 0.04), OPEN)[0]
        seen += (np.abs(depth - bare) > 1e-3).any()
    assert seen >= 3


def test_a_static_camera_gives_the_poses_it_was_given():
    T_base_camera = look_at((1.0, 0.0, 1.0), (1.0, 0.0, 0.0), up=(1.0, 0.0, 0.0))
    # Straight down: the picture's upper side is the base's x, its right side the base's -y.
    assert np.allclose(T_base_camera[:3, :3], [[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    camera = RaycastCamera(T_base_camera=T_base_camera)
    assert np.array_equal(camera.pose(np.stack((np.eye(4), FAR_AWAY))), np.stack((T_base_camera,) * 2))
    with pytest.raises(ConfigError, match="move one of the points"):
        look_at((1.0, 0.0, 1.0), (1.0, 0.0, 0.0))


def test_depth_of_a_box_and_the_table_by_hand(brick):
    # The released code's camera sits at (0.036, 0, 0.036) of the hand: 36.4 cm above the table.
    hand = pose_at(0.5, 0.0, 0.4, down=True)
    depth, mask = agree(RaycastCamera(CameraIntrinsics(33, 33)), brick, hand, pose_at(0.536, 0.0, 0.04))
    assert mask[16, 16] and depth[mask].min() == depth[16, 16] == pytest.approx(0.284, abs=1e-5)
    assert not mask[2, 16] and depth[2, 16] == pytest.approx(0.364, abs=1e-5)


def test_axes_are_those_of_opencv(brick):
    # The hand points down, x forward: the picture's right is the hand's y, its bottom the hand's -x.
    camera = RaycastCamera(CameraIntrinsics(32, 32))
    hand = pose_at(0.5, 0.0, 0.5, down=True)
    where = {}
    for name, offset in (("right", (0.0, 0.15, 0.2)), ("down", (-0.15, 0.0, 0.2))):
        _, mask = agree(camera, brick, hand, hand @ pose_at(*offset))
        rows, columns = np.nonzero(mask)
        where[name] = rows.mean() - 15.5, columns.mean() - 15.5
    assert where["right"][1] > 5 and where["down"][0] > 5


def test_the_table_hides_what_has_fallen_below_it(brick):
    camera = RaycastCamera(CameraIntrinsics(32, 32))
    hand = pose_at(0.5, 0.45, 0.4, down=True)
    _, on = agree(camera, brick, hand, pose_at(0.5, 0.45, 0.04))
    _, below = agree(camera, brick, hand, pose_at(0.5, 0.45, -0.2))
    _, beside = agree(camera, brick, hand, pose_at(0.5, 0.80, -0.2))  # past the rim at y = 0.65
    assert on.sum() > 5 and below.sum() == 0 and beside.sum() > 3


def test_fingers_hide_what_is_behind_them(brick):
    camera = RaycastCamera(CameraIntrinsics(48, 48))
    hand = pose_at(0.5, 0.0, 0.6, down=True)
    behind = hand @ pose_at(0.0, 0.0, 0.22)
    _, through_open = agree(camera, brick, hand, behind, OPEN)
    depth, past_closed = agree(camera, brick, hand, behind, CLOSED)
    assert 0 < past_closed.sum() < through_open.sum()
    assert depth[through_open & ~past_closed].max() < 0.0584 + 0.0545  # those pixels show a finger


def test_fingers_are_seen_at_any_opening_met_before_or_not(brick):
    camera = RaycastCamera(CameraIntrinsics(24, 24))
    hand = pose_at(0.5, 0.0, 0.6, down=True)
    first = look(camera, brick, hand, FAR_AWAY, OPEN)[0]
    for opening in np.linspace(0.0, 0.04, 100):
        look(camera, brick, hand, FAR_AWAY, np.array([opening, opening]))
    assert np.array_equal(look(camera, brick, hand, FAR_AWAY, OPEN)[0], first)


def test_nothing_is_seen_nearer_than_near_or_beyond_far(brick):
    hand, fingers = pose_at(0.8, 0.0, 1.0, down=True), OPEN
    camera = RaycastCamera(CameraIntrinsics(24, 24, near=0.2, far=0.55), T_ee_camera=np.eye(4))
    depth, mask = agree(camera, brick, hand, hand @ pose_at(0, 0, 0.5), fingers)
    assert depth[mask] == pytest.approx(np.full(mask.sum(), 0.46), abs=1e-5) and mask.any()
    assert np.all(depth[~mask] == 0.0)  # table beyond far, fingers before near
    for z in (0.1, 0.7):
        depth, mask = agree(camera, brick, hand, hand @ pose_at(0, 0, z), fingers)
        assert not mask.any()


def test_an_object_that_reaches_behind_the_near_plane_is_seen_from_inside(brick):
    camera = RaycastCamera(CameraIntrinsics(24, 24, near=0.1), T_ee_camera=np.eye(4))
    hand = pose_at(0.5, 0.0, 1.0, down=True)
    depth, mask = agree(camera, brick, hand, hand @ pose_at(0, 0, 0.1), OPEN)
    assert mask[12, 12] and depth[12, 12] == pytest.approx(0.14, abs=1e-5)


@pytest.mark.parametrize(
    "intrinsics",
    [
        CameraIntrinsics(31, 23, fov=1.1),
        CameraIntrinsics(31, 23, fx=25.0, fy=18.0, cx=4.0, cy=19.0),
    ],
)
def test_the_window_misses_no_pixel(brick, intrinsics):
    # The same picture, once with the object's outline cut out, once with all rays cast.
    class Everywhere(RaycastCamera):
        def _window(self, surface, T_object_camera):
            return slice(None), slice(None)

    hand = pose_at(0.5, 0.0, 0.5, down=True)
    rng = np.random.default_rng(0)
    seen = 0
    for _ in range(60):
        where = hand @ pose_at(*rng.uniform((-0.4, -0.4, -0.1), (0.4, 0.4, 0.6)))
        where[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        where[:3, 0] *= np.linalg.det(where[:3, :3])
        cut = look(RaycastCamera(intrinsics), brick, hand, where, OPEN)
        full = look(Everywhere(intrinsics), brick, hand, where, OPEN)
        assert np.array_equal(cut[0], full[0]) and np.array_equal(cut[1], full[1])
        seen += cut[1].any()
    assert seen > 10


@pytest.mark.parametrize("place", [{}, {"T_base_camera": look_at((1.2, 0.3, 0.6), (0.4, 0.0, 0.2))}])
def test_an_off_centre_picture_is_cut_out_of_a_larger_one(brick, place):
    """The same focal length, the axis elsewhere: arm, table and target are where the large one has them."""
    large = CameraIntrinsics(64, 48, fx=30.0, cx=31.5, cy=23.5)
    left, top = 9, 13
    cut = CameraIntrinsics(40, 30, fx=30.0, cx=31.5 - left, cy=23.5 - top)
    hand = pose_at(0.5, 0.0, 0.5, down=True)
    whole, mask = look(RaycastCamera(large, **place), brick, hand, hand @ pose_at(0, 0, 0.3), OPEN)
    part, part_mask = look(RaycastCamera(cut, **place), brick, hand, hand @ pose_at(0, 0, 0.3), OPEN)
    there = (slice(top, top + 30), slice(left, left + 40))
    assert np.allclose(part, whole[there], atol=1e-5) and np.array_equal(part_mask, mask[there])
    assert part_mask.any()


def test_two_objects_of_one_name_are_told_apart(brick, can):
    camera = RaycastCamera(CameraIntrinsics(16, 16))
    hand = pose_at(0.5, 0.0, 0.5, down=True)
    pictures = [
        look(camera, replace(o, name="x"), hand, hand @ pose_at(0, 0, 0.3), OPEN)[0] for o in (brick, can)
    ]
    assert not np.array_equal(*pictures)


@pytest.mark.parametrize(
    "options", [{"width": 0}, {"fov": 0.0}, {"fov": 4.0}, {"near": 0.5, "far": 0.4}, {"near": -1.0}]
)
def test_impossible_cameras_are_refused(options):
    with pytest.raises(ConfigError):
        CameraIntrinsics(**options)
