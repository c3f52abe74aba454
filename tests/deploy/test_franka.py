"""FrankaArm against franky-sim: frames, motions, gripper, and what a robot refuses."""

import sys

import numpy as np
import pytest

from tests.deploy.stage import connected, drawn, wait_for
from torchgrasp.deploy import ArmLimits, FrankaArm
from torchgrasp.errors import ConfigError, MissingPackageError, StopError
from torchgrasp.sim.kinematics import forward_kinematics


def test_the_hand_is_where_our_kinematics_put_it_whatever_the_end_effector():
    """An FR3 has the Panda's geometry; its tool may be configured to stand anywhere."""
    with connected() as (rehearsal, arm):
        here = forward_kinematics(arm.joints[None])[0]
        assert np.abs(arm.T_base_ee - here).max() < 1e-5
        tool = np.eye(4)
        tool[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
        tool[:3, 3] = (0.02, 0.01, 0.05)
        arm._robot.set_ee(tool.ravel(order="F").tolist())
        wait_for(lambda: np.abs(arm._robot.state.NE_T_EE.matrix - tool).max() < 1e-6)
        assert np.abs(arm.T_base_ee - here).max() < 1e-3
        # franky-sim takes the effector's new place for a motion at first.
        settled = rehearsal.clock() + 0.5
        wait_for(lambda: rehearsal.clock() > settled)
        there = here.copy()
        there[2, 3] += 0.05
        arm.go(there)
        # The impedance of franky-sim's arm comes to rest a little after the motion's end.
        wait_for(lambda: np.abs(forward_kinematics(arm.joints[None])[0] - there).max() < 2e-3)


def test_motions_are_blended_and_end_at_rest():
    seen = []
    with connected() as (rehearsal, arm):
        target, began = arm.T_base_ee, rehearsal.clock()
        rehearsal.watch(seen.append)
        for step in range(6):
            target = target.copy()
            target[2, 3] += 0.02
            arm.follow(target, 0.15)
            wait_for(lambda step=step: rehearsal.clock() >= began + 0.15 * (step + 1))
        wait_for(lambda: rehearsal.clock() > began + 1.4)
        assert np.abs(arm.T_base_ee - target).max() < 1e-3
    times = np.array([each.time for each in seen]) - began
    z = forward_kinematics(np.stack([each.joints[:7] for each in seen]))[:, 2, 3]
    assert (np.diff(z) > -1e-4).all()
    pace = np.gradient(z, times)[(times > 0.2) & (times < 0.8)]
    # 2 cm in 0.15 s are 0.13 m/s.
    # A busy machine's late command slows the arm; a pose never halts it.
    assert pace.min() > 0.01 and np.mean(pace < 0.05) < 0.1 and pace.max() < 0.25


def test_speed_is_limited():
    with connected(limits=ArmLimits(speed=0.1)) as (rehearsal, arm):
        target = arm.T_base_ee
        target[2, 3] += 0.08
        began = rehearsal.clock()
        arm.follow(target, 0.15)
        wait_for(lambda: abs(arm.T_base_ee[2, 3] - target[2, 3]) < 2e-3)
        assert rehearsal.clock() - began > 0.6  # 0.25 s at 0.5 m/s


def test_fingers_close_and_their_width_tells_that_nothing_is_held():
    with connected() as (_, arm):
        arm.grasp(20.0)
        assert arm.width < 0.001
        arm.open()
        assert arm.width > 0.078


def test_a_posture_outside_the_limits_is_not_gone_to():
    with connected() as (_, arm):
        here = arm.joints
        with pytest.raises(StopError, match="joint 4"):
            arm.go_to_joints(np.where(np.arange(7) == 3, -0.1, here))
        for wrong in (here[:6], np.full(7, np.nan)):
            with pytest.raises(ConfigError, match="posture"):
                arm.go_to_joints(wrong)
        with pytest.raises(ConfigError, match="speed"):
            arm.go_to_joints(here, speed=0.0)


def test_joints_are_reached():
    with connected() as (_, arm):
        q = drawn()[1].q.copy()
        q[0] += 0.1
        arm.go_to_joints(q, speed=0.3)
        assert np.abs(arm.joints - q).max() < 2e-3


def test_a_hand_that_is_pushed_into_the_table_stops_by_a_reflex():
    with connected() as (_, arm):
        low = arm.T_base_ee
        low[2, 3] = 0.0
        with pytest.raises(StopError, match="stopped by itself") as caught:
            arm.go(low)
        assert caught.value.cause == "reflex"


def test_a_robot_that_is_not_there():
    with pytest.raises(StopError, match="does not do it") as caught:
        FrankaArm("127.255.0.9", realtime=False)
    assert caught.value.cause == "robot"


def test_without_franky_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(MissingPackageError, match=r"torchgrasp\[franka\]"):
        FrankaArm("127.0.0.1")
