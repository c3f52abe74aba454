import numpy as np
import pytest
import sapien
from sapien import physx

from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.panda import Panda

# Postures well inside the limits.
_MIDDLE = (kin.JOINT_LOWER + kin.JOINT_UPPER) / 2
_HALF = (kin.JOINT_UPPER - kin.JOINT_LOWER) / 2


def random_postures(n: int, *, seed: int = 0, share: float = 0.8) -> np.ndarray:
    return _MIDDLE + share * _HALF * np.random.default_rng(seed).uniform(-1, 1, (n, 7))


def turned(pose: np.ndarray, *, move=(0.0, 0.0, 0.0), yaw: float = 0.0) -> np.ndarray:
    change = np.eye(4)
    change[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    change[:3, 3] = move
    return pose @ change


def test_hand_and_tool_centre_point_of_the_ready_posture():
    T_base_ee = kin.forward_kinematics(kin.READY_POSTURE[None])[0]
    assert T_base_ee[:3, 3] == pytest.approx([0.615013, 0, 0.273182], abs=1e-5)
    tip = T_base_ee @ [0, 0, 0.1034, 1]
    assert tip[:3] == pytest.approx([0.615013, 0, 0.169782], abs=1e-5)
    # Quaternion wxyz (0, 1, 0, 0): half a turn about x.
    assert T_base_ee[:3, :3] == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-5)


def test_link_poses_are_those_of_the_simulated_articulation():
    scene = sapien.Scene([physx.PhysxCpuSystem()])
    panda = Panda(scene)
    names = [*(f"link{i}" for i in range(1, 8)), "hand"]
    for q in random_postures(5):
        panda.place(q)
        poses = kin.link_poses(q[None])[0]
        for name, pose in zip(names, poses, strict=True):
            link = panda.articulation.find_link_by_name(name)
            assert link.entity_pose.to_transformation_matrix() == pytest.approx(pose, abs=2e-5)


def test_jacobian_is_the_derivative_of_the_pose():
    q, h = random_postures(10), 1e-6
    j = kin.jacobian(kin.link_poses(q))
    here = kin.forward_kinematics(q)
    for i in range(7):
        there = kin.forward_kinematics(q + h * np.eye(7)[i])
        assert kin.pose_error(here, there) / h == pytest.approx(j[:, :, i], abs=1e-5)


def test_pose_error_carries_one_pose_to_the_other():
    pose = np.eye(4)[None]
    target = turned(np.eye(4), move=(0.1, -0.2, 0.3), yaw=2.0)[None]
    assert kin.pose_error(pose, target)[0] == pytest.approx([0.1, -0.2, 0.3, 0, 0, 2.0])
    assert kin.pose_error(target, target)[0] == pytest.approx(np.zeros(6), abs=1e-12)


def test_rows_do_not_depend_on_their_neighbours():
    q = random_postures(17)
    for i in range(len(q)):
        assert np.array_equal(kin.link_poses(q[i : i + 1])[0], kin.link_poses(q)[i])


def test_sampled_postures_reach_the_pose_within_the_limits_nearest_first():
    for q in random_postures(10, seed=1):
        pose = kin.forward_kinematics(q[None])[0]
        found = kin.sample_postures(pose, q)
        assert len(found)
        assert kin.forward_kinematics(found) == pytest.approx(np.tile(pose, (len(found), 1, 1)), abs=1e-5)
        assert np.all(found >= kin.JOINT_LOWER) and np.all(found <= kin.JOINT_UPPER)
        distance = np.linalg.norm(found - q, axis=-1)
        assert np.all(np.diff(distance) >= 0) and distance[0] < 0.2


def test_there_is_no_posture_for_a_pose_out_of_reach():
    pose = np.eye(4)
    pose[:3, 3] = (1.5, 0.0, 0.5)
    assert kin.sample_postures(pose, kin.READY_POSTURE).shape == (0, 7)
