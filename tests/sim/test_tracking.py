"""Inverse kinematics from step to step: convergence, limits, independence of the rows."""

import numpy as np
import pytest

from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.tracking import track_pose

_MIDDLE = (kin.JOINT_LOWER + kin.JOINT_UPPER) / 2
_HALF = (kin.JOINT_UPPER - kin.JOINT_LOWER) / 2


def random_postures(n: int, *, seed: int = 0, share: float = 0.8) -> np.ndarray:
    return _MIDDLE + share * _HALF * np.random.default_rng(seed).uniform(-1, 1, (n, 7))


def test_tracking_a_step_converges_within_the_limits():
    q = random_postures(100, share=0.7)
    targets = kin.forward_kinematics(q + np.random.default_rng(1).uniform(-0.1, 0.1, q.shape))
    found, left = track_pose(q, targets)
    assert left.max() < 1e-5
    assert np.all(found >= kin.JOINT_LOWER) and np.all(found <= kin.JOINT_UPPER)
    error = np.abs(kin.pose_error(kin.forward_kinematics(found), targets)).max(-1)
    assert error == pytest.approx(left, abs=2e-6)  # poses pass through float32
    assert np.median(np.abs(found - q).max(-1)) < 0.1  # smooth: no other branch of postures


def test_a_pose_out_of_reach_is_approached_and_its_error_told():
    q = kin.READY_POSTURE[None]
    target = kin.forward_kinematics(q)
    target[0, :3, 3] = (2.0, 0.0, 0.5)
    found, left = track_pose(q, target, iterations=40)
    assert left[0] > 0.5
    assert np.all(found >= kin.JOINT_LOWER) and np.all(found <= kin.JOINT_UPPER)
    reach = kin.forward_kinematics(found)[0, 0, 3]
    assert reach > kin.forward_kinematics(q)[0, 0, 3]


def test_tracking_starts_inside_the_limits_whatever_it_is_given():
    q = np.full((1, 7), 10.0)
    found, _ = track_pose(q, kin.forward_kinematics(kin.READY_POSTURE[None]))
    assert np.all(found >= kin.JOINT_LOWER) and np.all(found <= kin.JOINT_UPPER)
    assert np.all(q == 10.0)  # the argument is not written to


def test_joints_at_their_limits_leave_the_way_to_the_others():
    # Beyond these postures Newton's steps alone would leave the limits.
    q = np.clip(random_postures(60, share=1.0, seed=3) * 1.2, kin.JOINT_LOWER, kin.JOINT_UPPER)
    targets = kin.forward_kinematics(q)
    targets[:, :3, 3] += np.random.default_rng(4).uniform(-0.02, 0.02, (60, 3))
    found, left = track_pose(q, targets)
    assert np.all(found >= kin.JOINT_LOWER) and np.all(found <= kin.JOINT_UPPER)
    assert (left < 1e-4).mean() > 0.5


def test_a_wrist_at_its_stop_turns_no_further_and_holds_the_hand_back_no_more():
    q = random_postures(200, share=0.6, seed=5)
    q[:, 6] = kin.JOINT_UPPER[6]
    turned = q.copy()
    turned[:, 6] += 0.3  # where no wrist goes
    targets = kin.forward_kinematics(turned)
    targets[:, :3, 3] += np.random.default_rng(6).uniform(-0.03, 0.03, (200, 3))
    found, _ = track_pose(q, targets)
    assert np.all(found <= kin.JOINT_UPPER)
    error = np.abs(kin.pose_error(kin.forward_kinematics(found), targets))
    position, rotation = error[:, :3].max(-1), error[:, 3:].max(-1)
    assert (position < 2e-3).mean() > 0.95  # at equal weights one in ten is 12 cm off
    assert (rotation < 0.35).mean() > 0.95


def test_rows_do_not_depend_on_their_neighbours():
    q = random_postures(17, share=1.0)
    targets = kin.forward_kinematics(q + 0.05)
    together, left = track_pose(q, targets)
    for i in range(len(q)):
        alone, left_alone = track_pose(q[i : i + 1], targets[i : i + 1])
        assert np.array_equal(alone[0], together[i]) and left_alone[0] == left[i]


def test_no_rows_are_welcome():
    found, left = track_pose(np.empty((0, 7)), np.empty((0, 4, 4)))
    assert found.shape == (0, 7) and left.shape == (0,)
