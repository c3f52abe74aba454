"""Action spaces: what they lead to, the labels they give, the table that none of them enters."""

import numpy as np
import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.control import TABLE_GUARD, make_action_space

NAMES = ("ee_delta", "joint_delta", "joint_velocity")


def some_postures(n: int) -> np.ndarray:
    return kin.READY_POSTURE + np.random.default_rng(0).uniform(-0.2, 0.2, (n, 7))


def nearby(T_base_ee: np.ndarray) -> np.ndarray:
    """Hand poses a small step away."""
    q = some_postures(len(T_base_ee)) + np.random.default_rng(1).uniform(-0.05, 0.05, (len(T_base_ee), 7))
    return kin.forward_kinematics(q)


@pytest.mark.parametrize("name", NAMES)
def test_the_action_towards_a_pose_leads_there(name):
    space, q = make_action_space(name), some_postures(20)
    hands = kin.forward_kinematics(q)
    targets = nearby(hands)
    action = space.action_towards(q, hands, targets)
    assert action.shape == (20, space.size) and np.all(np.abs(action) < space.bound)
    reached = kin.forward_kinematics(space.posture(q, hands, action))
    assert np.abs(kin.pose_error(reached, targets)).max() < 2e-4


@pytest.mark.parametrize("name", NAMES)
def test_no_action_leaves_the_arm_where_it_is(name):
    space, q = make_action_space(name), some_postures(3)
    still = space.posture(q, kin.forward_kinematics(q), np.zeros((3, space.size)))
    assert still == pytest.approx(q, abs=1e-6)


def test_joint_actions_are_angles_and_rates():
    q = some_postures(2)
    hands, change = kin.forward_kinematics(q), np.full((2, 7), 0.03)
    delta = make_action_space("joint_delta").posture(q, hands, change)
    rate = make_action_space("joint_velocity", control_period=0.2).posture(q, hands, change / 0.2)
    assert delta == pytest.approx(q + 0.03) and rate == pytest.approx(q + 0.03)


def test_joint_bounds_are_what_a_joint_may_turn_in_a_step():
    assert make_action_space("joint_delta").bound[0] == pytest.approx(2.175 * 0.15)
    assert make_action_space("joint_velocity").bound[6] == pytest.approx(2.61)


@pytest.mark.parametrize("name", NAMES)
def test_no_action_puts_the_hand_into_the_table(name):
    space = make_action_space(name)
    T = np.diag([1.0, -1.0, -1.0, 1.0])[None]
    T[0, :3, 3] = 0.5, 0.0, 0.125
    q = kin.sample_postures(T[0], kin.READY_POSTURE)[:1]
    lower = T.copy()
    lower[0, 2, 3] -= 0.04
    reached = kin.forward_kinematics(space.posture(q, T, space.action_towards(q, T, lower)))
    assert lowest_point(reached)[0] == pytest.approx(TABLE_GUARD, abs=5e-4)


def test_an_unknown_space_is_refused():
    with pytest.raises(ConfigError, match="action_space='torque'"):
        make_action_space("torque")  # type: ignore[arg-type]
