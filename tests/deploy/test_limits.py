"""ArmLimits: what is outside is refused with a reason, what is too fast is shortened."""

import numpy as np
import pytest

from torchgrasp.deploy import PANDA_JOINTS, ArmLimits
from torchgrasp.errors import ConfigError, StopError
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim.kinematics import READY_POSTURE, forward_kinematics


def hand(x=0.5, y=0.0, z=0.4):
    pose = np.diag((1.0, -1.0, -1.0, 1.0))
    pose[:3, 3] = x, y, z
    return pose


@pytest.mark.parametrize(
    ("place", "told"), [({"x": 1.0}, "x = 1.000"), ({"y": -0.9}, "y"), ({"z": 1.2}, "z")]
)
def test_a_pose_outside_the_workspace_is_refused(place, told):
    ArmLimits().check_pose(hand())
    with pytest.raises(StopError, match=f"the hand would be at {told}") as caught:
        ArmLimits().check_pose(hand(**place))
    assert caught.value.cause == "limits"


def test_the_fingertips_stay_above_the_table_whatever_its_height():
    tips = 0.4 - float(lowest_point(hand()))
    limits = ArmLimits(table_height=0.1, clearance=0.005)
    limits.check_pose(hand(z=tips + 0.106))
    with pytest.raises(StopError, match=r"4\.0 mm above the table, less than the clearance of 5\.0 mm"):
        limits.check_pose(hand(z=tips + 0.104))


def test_joints_near_a_limit_are_refused_and_panda_and_fr3_differ():
    q = READY_POSTURE.copy()
    ArmLimits().check_joints(q)
    q[5] = 0.3  # an FR3's sixth joint begins at 0.5445
    ArmLimits(joints=PANDA_JOINTS).check_joints(q)
    with pytest.raises(StopError, match=r"joint 6 at 0\.300 rad is near or beyond its limits"):
        ArmLimits().check_joints(q)


def test_a_step_that_is_too_fast_is_shortened_along_its_way():
    limits = ArmLimits(speed=0.2, turn_rate=1.0)
    here = forward_kinematics(READY_POSTURE[None])[0]
    there = here.copy()
    there[:3, 3] += (0.06, 0.0, -0.08)
    short = limits.shorten(here, there, 0.15)
    assert np.allclose(short[:3, 3] - here[:3, 3], np.array((0.06, 0.0, -0.08)) * 0.3)
    assert np.allclose(short[:3, :3], here[:3, :3])
    turned = here.copy()
    turned[:3, :3] = here[:3, :3] @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    left = here[:3, :3].T @ limits.shorten(here, turned, 0.15)[:3, :3]
    assert np.arctan2(left[1, 0], left[0, 0]) == pytest.approx(0.15)
    near = here.copy()
    near[0, 3] += 0.01
    assert limits.shorten(here, near, 0.15) is near


def test_a_joint_in_the_way_lets_the_hand_go_and_turns_it_as_far_as_it_can():
    limits = ArmLimits()
    q = READY_POSTURE.copy()
    q[6] = limits.joints[1][6] - 0.15
    here = forward_kinematics(q[None])[0]
    c, s = np.cos(0.4), np.sin(0.4)
    turned = here @ np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1.0]])
    pose = limits.reach(q, turned)
    assert np.allclose(pose[:3, 3], turned[:3, 3])
    left = here[:3, :3].T @ pose[:3, :3]
    assert abs(np.arctan2(left[1, 0], left[0, 0])) < 0.12
    back = here @ np.array([[c, s, 0, 0], [-s, c, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1.0]])
    assert limits.reach(q, back) is back


@pytest.mark.parametrize(
    "option",
    [
        {"speed": 2.0},
        {"turn_rate": 0.0},
        {"workspace": ((0, 0, 0), (1, 1))},
        {"joints": ((1,) * 7, (0,) * 7)},
    ],
)
def test_impossible_limits_are_refused(option):
    (name,) = option
    with pytest.raises(ConfigError, match=f"^{name}="):
        ArmLimits(**option)


def test_a_pose_of_no_numbers_is_refused():
    for entry in ((0, 0), (1, 3)):
        pose = forward_kinematics(READY_POSTURE[None])[0]
        pose[entry] = np.nan
        with pytest.raises(StopError):
            ArmLimits().check_pose(pose)


def test_a_pose_beyond_the_arm_s_length_is_not_gone_to():
    hand = forward_kinematics(READY_POSTURE[None])[0]
    far = hand.copy()
    far[0, 3] += 0.5
    reached = ArmLimits(joints=PANDA_JOINTS).reach(READY_POSTURE, far)
    assert reached[0, 3] - hand[0, 3] < 0.3


@pytest.mark.parametrize("workspace", [3, None, ((0.0, 0.0, 0.0),), "box"])
def test_what_is_no_box_is_refused(workspace):
    with pytest.raises(ConfigError, match="workspace"):
        ArmLimits(workspace=workspace)
