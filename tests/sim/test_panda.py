"""The simulated arm against the numbers of franka_ros."""

import numpy as np
import pytest
import sapien
from sapien import physx

from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.panda import Panda
from torchgrasp.sim.panda_tables import FINGER_CLOSED, FINGER_OPEN, hand_boxes

READY = kin.READY_POSTURE


class Stand:
    """A Panda alone in a scene."""

    def __init__(self, q: np.ndarray = READY) -> None:
        self.system = physx.PhysxCpuSystem()
        self.system.timestep = 1 / 240
        self.scene = sapien.Scene([self.system])
        self.panda = Panda(self.scene)
        self.panda.place(q)

    @property
    def q(self) -> np.ndarray:
        return self.panda.articulation.qpos

    def step(self, seconds: float) -> None:
        for _ in range(round(seconds * 240)):
            self.system.step()

    def link(self, name: str):
        return self.panda.articulation.find_link_by_name(name)


def test_joint_limits_hold_under_drives_beyond_them():
    for limit, sign in ((kin.JOINT_LOWER, -1), (kin.JOINT_UPPER, 1)):
        for joint in (0, 3, 5, 6):
            stand = Stand()
            target = READY.copy()
            target[joint] = limit[joint] + sign * 0.5
            if joint == 3:
                target[5] = 3.6  # folded like this, the hand stays off the base
            stand.panda.drive_arm(target)
            stand.step(2.0)
            assert stand.q[joint] == pytest.approx(limit[joint], abs=0.01)


def test_joint_limits_efforts_and_speeds_are_the_robots():
    panda = Stand().panda
    joints = panda.articulation.active_joints
    limits = np.array([joint.limits[0] for joint in joints])
    assert limits[:7, 0] == pytest.approx([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
    assert limits[:7, 1] == pytest.approx([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
    assert limits[7:] == pytest.approx(np.array([[0, 0.04], [0, 0.04]]), abs=1e-6)
    assert [joint.force_limit for joint in joints[:7]] == pytest.approx([87] * 4 + [12] * 3)


def test_masses_and_inertias_are_those_published():
    stand = Stand()
    masses = [
        0.629769,
        4.970684,
        0.646926,
        3.228604,
        3.587895,
        1.225946,
        1.666555,
        0.735522,
        0.73,
        0.015,
        0.015,
    ]
    assert [link.mass for link in stand.panda.links] == pytest.approx(masses, rel=1e-5)
    assert sum(link.mass for link in stand.panda.links) == pytest.approx(sum(masses))
    link1 = stand.link("link1")
    turn = link1.cmass_local_pose.to_transformation_matrix()[:3, :3]
    tensor = turn @ np.diag(link1.inertia) @ turn.T
    expected = [
        [0.70337, -0.000139, 0.006772],
        [-0.000139, 0.70661, 0.019169],
        [0.006772, 0.019169, 0.009117],
    ]
    assert tensor == pytest.approx(np.array(expected), abs=1e-4)
    assert link1.cmass_local_pose.p == pytest.approx([0.003875, 0.002081, -0.04762], abs=1e-6)


# Size, position and roll in the left finger's frame.
FINGER_BOXES = (
    ((0.022, 0.015, 0.020), (0, 0.0185, 0.011), 0.0),
    ((0.022, 0.0088, 0.0038), (0, 0.0068, 0.0022), 0.0),
    ((0.0175, 0.007, 0.0235), (0, 0.0159, 0.02835), np.pi / 6),
    ((0.0175, 0.0152, 0.0185), (0, 0.00758, 0.04525), 0.0),
)


@pytest.mark.parametrize("name, side", [("left_finger", 1), ("right_finger", -1)])
def test_finger_boxes_are_exact(name, side):
    shapes = Stand().link(name).collision_shapes
    assert len(shapes) == len(FINGER_BOXES)
    for shape, (size, (x, y, z), roll) in zip(shapes, FINGER_BOXES, strict=True):
        assert 2 * shape.half_size == pytest.approx(size, abs=1e-6)
        pose = shape.local_pose.to_transformation_matrix()
        assert pose[:3, 3] == pytest.approx([x, side * y, z], abs=1e-6)
        assert np.arctan2(pose[2, 1], pose[2, 2]) == pytest.approx(side * roll, abs=1e-5)
        assert shape.physical_material.static_friction == pytest.approx(2.0)


def test_hand_box_has_the_size_of_the_hand():
    (shape,) = Stand().link("hand").collision_shapes
    assert 2 * shape.half_size == pytest.approx([0.063, 0.204, 0.092], abs=1e-6)


@pytest.mark.parametrize("left, right", [(0.04, 0.04), (0.01, 0.03), (0.0, 0.0)])
def test_gap_between_the_pads_is_the_sum_of_the_finger_positions(left, right):
    boxes = hand_boxes(left, right)
    pads = [(pose, size) for pose, size in boxes if size == pytest.approx([0.0175, 0.0152, 0.0185])]
    faces = sorted(pose[1, 3] - np.sign(pose[1, 3]) * size[1] / 2 for pose, size in pads)
    assert faces[1] - faces[0] == pytest.approx(left + right, abs=1e-4)


def test_hand_boxes_stand_where_the_simulation_has_them():
    stand = Stand()
    T_ee_base = np.linalg.inv(stand.link("hand").entity_pose.to_transformation_matrix())
    expected = []
    for name in ("hand", "left_finger", "right_finger"):
        link = stand.link(name)
        T_ee_link = T_ee_base @ link.entity_pose.to_transformation_matrix()
        expected += [T_ee_link @ s.local_pose.to_transformation_matrix() for s in link.collision_shapes]
    for (pose, _), other in zip(hand_boxes(), expected, strict=True):
        assert pose == pytest.approx(other, abs=1e-5)


def test_the_hands_lowest_point_is_that_of_its_boxes():
    signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 3)
    corners = np.concatenate([signs * size @ pose[:3, :3].T + pose[:3, 3] for pose, size in hand_boxes()])
    poses = np.tile(np.eye(4), (500, 1, 1))
    poses[:, :3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(500, 3, 3)))[0]
    expected = (corners @ poses[:, 2, :3, None])[..., 0].min(-1)
    assert lowest_point(poses) == pytest.approx(expected, abs=2e-5)


def fold(joint_targets: dict[int, float], seconds: float = 3.0) -> Stand:
    stand = Stand()
    target = READY.copy()
    for joint, angle in joint_targets.items():
        target[joint] = angle
    stand.panda.drive_arm(target)
    stand.step(seconds)
    return stand


def test_neighbouring_links_never_block_the_arm():
    # Postures over the whole range of each joint that keep the others at rest.
    for joint in (0, 2, 4, 6):
        for limit in (kin.JOINT_LOWER, kin.JOINT_UPPER):
            angle = limit[joint] * 0.95
            assert fold({joint: angle}).q[joint] == pytest.approx(angle, abs=0.02)


def test_the_ready_posture_stands_free_of_contact():
    stand = Stand()
    stand.step(1.0)
    assert stand.q[:7] == pytest.approx(READY, abs=1e-3)
    assert not stand.system.get_contacts() or all(
        max(abs(p.impulse).max() for p in contact.points) == 0 for contact in stand.system.get_contacts()
    )


def test_the_forearm_and_hand_collide_with_the_base():
    # The upper arm leans back and the elbow folds: the hand would end inside the robot's base.
    q = np.array([0.0, -0.6, 0.0, -3.05, 0.0, 0.3, 0.785])
    hand = kin.forward_kinematics(q[None])[0, :3, 3]
    stand = Stand()
    stand.panda.drive_arm(q)
    touched = False
    for _ in range(40):
        stand.step(0.1)
        for contact in stand.system.get_contacts():
            touched |= any(np.abs(p.impulse).max() > 0 for p in contact.points)
    blocked = np.abs(stand.q[:7] - q).max()
    assert touched and blocked > 0.05, (hand, blocked)


def test_the_fingers_close_and_open_at_their_speed():
    stand = Stand()
    stand.panda.drive_fingers(FINGER_CLOSED)
    stand.step(0.1)
    # 0.2 m/s; PhysX holds a speed limit softly.
    assert np.all(stand.q[7:] > 0.04 - 0.3 * 0.1) and np.all(stand.q[7:] < 0.04 - 0.15 * 0.1)
    stand.step(0.4)
    assert stand.q[7:] == pytest.approx([0, 0], abs=2e-3)
    stand.panda.drive_fingers(FINGER_OPEN)
    stand.step(0.5)
    assert stand.q[7:] == pytest.approx([0.04, 0.04], abs=2e-3)
