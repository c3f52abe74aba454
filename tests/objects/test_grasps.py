import numpy as np
import pytest

from torchgrasp.objects.build import graspable_at_rest
from torchgrasp.objects.families import FAMILIES
from torchgrasp.objects.grasps import sample_grasps
from torchgrasp.objects.gripper import clear_of_table, hand_blocked
from torchgrasp.objects.resting import resting_poses
from torchgrasp.objects.solids import box, cylinder, mass_properties
from torchgrasp.objects.surface import RayTarget, face_normals, sample_surface


def open_hand_boxes():
    """Centres, half extents and rotations of the hand and of both fingers, open, in the ee frame."""
    yield np.array((0.0, 0.0, 0.02)), np.array((0.063, 0.204, 0.092)) / 2, np.eye(3)
    pieces = (
        ((0.022, 0.015, 0.020), (0.0, 0.0185, 0.011), 0.0),
        ((0.022, 0.0088, 0.0038), (0.0, 0.0068, 0.0022), 0.0),
        ((0.0175, 0.007, 0.0235), (0.0, 0.0159, 0.02835), np.pi / 6),
        ((0.0175, 0.0152, 0.0185), (0.0, 0.00758, 0.04525), 0.0),
    )
    for side in (1.0, -1.0):
        for size, (x, y, z), roll in pieces:
            c, s = np.cos(side * roll), np.sin(side * roll)
            turn = np.array(((1, 0, 0), (0, c, -s), (0, s, c)))
            yield np.array((x, side * (y + 0.04), z + 0.0584)), np.array(size) / 2, turn


def some(item, count=8):
    return item.grasps[np.random.default_rng(0).permutation(len(item.grasps))[:count]].astype(np.float64)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", [10, 11, 12])
def test_every_family_has_a_hundred_grasps(family, seed):
    rng = np.random.default_rng(seed)
    solid = FAMILIES[family](rng)
    solid = solid.moved(-mass_properties(solid.parts)[1])
    grasps = sample_grasps(solid.vertices, solid.faces, solid.parts, count=120, rng=rng)
    assert len(grasps.poses) >= 100
    assert grasps.quality.min() >= 0 and grasps.quality.max() <= 1


def test_grasps_are_rigid_poses_in_pairs_of_half_turns(item):
    turns = item.grasps[:, :3, :3].astype(np.float64)
    assert np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() < 1e-5
    assert np.linalg.det(turns) == pytest.approx(np.ones(len(turns)), abs=1e-5)
    half = np.diag((-1.0, -1.0, 1.0, 1.0)).astype(np.float32)
    assert np.allclose(item.grasps[1::2], item.grasps[::2] @ half, atol=1e-6)
    assert len(item.grasp_quality) == len(item.grasps)


def test_open_hand_is_clear_at_the_grasp_and_on_its_way(item):
    rng = np.random.default_rng(1)
    points, _ = sample_surface(item.vertices.astype(np.float64), item.faces, 8000, rng)
    for T_object_ee in some(item):
        local = (points - T_object_ee[:3, 3]) @ T_object_ee[:3, :3]
        for back in np.linspace(0.0, 0.08, 9):
            for centre, half, turn in open_hand_boxes():
                inside = np.abs((local + np.array((0.0, 0.0, back)) - centre) @ turn) < half
                assert not inside.all(axis=1).any()


def test_pads_meet_the_object_squarely_and_at_once(item):
    vertices = item.vertices.astype(np.float64)
    target, normals = RayTarget(vertices, item.faces), face_normals(vertices, item.faces)[0]
    x, z = np.meshgrid(np.linspace(-0.0085, 0.0085, 8), 0.10365 + np.linspace(-0.009, 0.009, 8))
    for T_object_ee in some(item):
        gaps = []
        for side in (1.0, -1.0):
            local = np.stack((x.ravel(), np.full(x.size, side * 0.04), z.ravel()), axis=1)
            origins = local @ T_object_ee[:3, :3].T + T_object_ee[:3, 3]
            outward = side * T_object_ee[:3, 1]
            distance, face = target.cast(origins, np.tile(-outward, (len(origins), 1)))
            met = distance < distance.min() + 0.003
            assert met.mean() > 0.2  # 0.3 of a coarser grid
            normal = normals[face[met]].mean(0)
            assert normal @ outward / np.linalg.norm(normal) > np.cos(0.4)
            gaps.append(distance.min())
        assert 0.005 - 1e-6 <= sum(gaps) < 0.08  # the object is at most 7.5 cm wide
        assert gaps[0] == pytest.approx(gaps[1], abs=1e-3)


def test_grasps_differ(item):
    """The nearest neighbour of a grasp is on average millimetres or degrees away, not a copy."""
    grasps = item.grasps[::2]
    points = np.array(((0, 0, 0), (0, 0.053, 0.105), (0, -0.053, 0.105)))
    places = np.einsum("gij,pj->gpi", grasps[:, :3, :3], points) + grasps[:, None, :3, 3]
    apart = np.abs(places[:, None] - places[None]).sum(-1).mean(-1) + np.eye(len(grasps))
    assert apart.min(1).mean() > 0.003


def test_nothing_holds_a_box_wider_than_the_hand():
    big = box((0.09, 0.1, 0.12))
    grasps = sample_grasps(big.vertices, big.faces, big.parts, count=100, rng=np.random.default_rng(0))
    assert grasps.poses.shape == (0, 4, 4)


def test_hand_blocked_by_hand_computed_points():
    pose = np.eye(4)[None]
    between, in_pad, in_palm, ahead = ((0, 0, 0.1), (0, 0.045, 0.1), (0, 0, 0.06), (0, 0.045, 0.12))
    assert not hand_blocked(np.array([between, ahead]), pose, approach=0.0)[0]
    assert hand_blocked(np.array([in_pad]), pose, approach=0.0)[0]
    assert hand_blocked(np.array([in_palm]), pose, approach=0.0)[0]
    behind = np.array([(0, 0.045, 0.07)])  # beside the finger's root, where its pad passed before
    assert not hand_blocked(behind, pose, approach=0.0)[0]
    assert hand_blocked(behind, pose, approach=0.08)[0]


def test_clear_of_table_by_hand_computed_heights():
    down = np.diag((1.0, -1.0, -1.0, 1.0))
    flat = np.array(((0.0, 0, 1, 0), (0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 0, 1)))  # approach along the table
    poses = np.stack((down, down, flat, flat, np.eye(4)))
    # Pointing down, the pads' ends are 0.1129 below the hand; lying, half the hand's thickness counts;
    # from below, the hand comes up from 8 cm under its rear at -0.026.
    poses[:, 2, 3] = 0.1130, 0.1128, 0.0316, 0.0314, 0.1059
    assert clear_of_table(poses, margin=0.0).tolist() == [True, False, True, False, False]


def test_objects_at_rest_leave_grasps_above_the_table(item):
    assert graspable_at_rest(item) >= 0.5


def test_grasps_clear_of_the_table_come_first():
    rod = cylinder(0.015, 0.15)
    poses, _ = resting_poses(rod.parts[0])
    clear = []
    for resting in (None, poses):
        rng = np.random.default_rng(0)
        found = sample_grasps(rod.vertices, rod.faces, rod.parts, count=100, rng=rng, resting=resting)
        clear.append(min(clear_of_table(pose @ found.poses).sum() for pose in poses))
    assert clear[1] > clear[0] and clear[1] >= 4
