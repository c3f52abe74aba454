"""Actions tried in copies of the worlds, as the last of an episode."""

import numpy as np
import pytest
import torch
from torchrl.envs.utils import step_mdp

from tests.envs.test_grasp_env import make_env
from torchgrasp.envs import GraspEnv
from torchgrasp.envs.motion import Presentation, TargetMotion
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy

OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100)
AWAY = torch.tensor([0.0, 0.0, -0.06, 0.0, 0.0, 0.0])


def drive(env: GraspEnv, steps: int):
    """The state after so many steps of the expert, with its next action."""
    expert = ExpertPolicy(env.objects, horizon=env.horizon, action_space=env.actions)
    state = env.reset()
    for _ in range(steps):
        state = step_mdp(env.step(expert(state)))
    return expert(state)


@pytest.fixture(scope="module")
def before_the_end():
    env = make_env(3, horizon=22, objects=OBJECTS)
    return env, drive(env, 21)


def test_what_is_tried_comes_true(before_the_end):
    """The expert's last action lifts in a copy as it then does; away from the object nothing is lifted."""
    env, state = before_the_end
    tried = torch.stack((state["action"], AWAY.expand(3, 6)), dim=1)
    lifted = env.try_last_actions(tried)
    assert lifted.dtype == torch.bool and not lifted[:, 1].any()
    happened = env.step(state)["next", "reward"].squeeze(-1) > 0
    assert happened.sum() >= 2 and torch.equal(lifted[:, 0], happened)


def test_trying_changes_nothing():
    """The next step is the same, bit for bit, whether actions were tried before it or not."""
    ends = []
    for tries in (0, 2):
        env = make_env(2, horizon=6, objects=OBJECTS)
        state = drive(env, 3)
        if tries:
            env.try_last_actions(0.02 * torch.randn(2, tries, 6))
        ends.append(env.step(state)["next"])
    for key in ("T_base_ee", "T_base_object", "joints", "joint_velocities"):
        assert torch.equal(ends[0][key], ends[1][key])


class LeavesAtTheEnd(TargetMotion):
    """The target lies still until it jumps away at step 22."""

    def present(self, rng, T_base_object, area):
        moves = np.zeros((22, 3))
        moves[21, 1] = 0.3
        return Presentation(T_base_object, moves)


def test_a_target_that_moves_in_this_step_moves_in_the_copies_too():
    """Actions that lift a target that stays lift none that goes, in the copies as in the worlds."""
    env = make_env(3, horizon=22, objects=OBJECTS, target_motion=LeavesAtTheEnd())
    state = drive(env, 21)
    tried = env.try_last_actions(state["action"].unsqueeze(1))
    assert not tried.any() and not env.step(state)["next", "reward"].any()


def test_actions_that_are_no_numbers_are_refused():
    env = make_env(2, objects=OBJECTS)
    with pytest.raises(TorchgraspError, match="call reset first"):
        env.try_last_actions(torch.zeros(2, 1, 6))
    env.reset()
    with pytest.raises(TorchgraspError, match="NaN or infinity"):
        env.try_last_actions(torch.full((2, 1, 6), torch.nan))


def test_where_an_episode_is_over_nothing_is_lifted():
    env = make_env(2, horizon=1, objects=OBJECTS)
    env.step(env.reset().set("action", torch.zeros(2, 6)))
    assert not env.try_last_actions(torch.zeros(2, 3, 6)).any()


@pytest.mark.parametrize("shape", [(2, 6), (3, 1, 6), (2, 1, 7)])
def test_actions_of_another_shape_are_refused(shape):
    env = make_env(2, objects=OBJECTS)
    env.reset()
    with pytest.raises(ConfigError, match=r"give \(N, M, A\), here \(2, M, 6\)"):
        env.try_last_actions(torch.zeros(shape))


def test_a_step_tells_what_the_proposed_actions_would_have_brought():
    """At the last step, as a trial tells; before, and without proposals, nothing is tried."""
    env = make_env(3, horizon=22, objects=OBJECTS)
    state = drive(env, 20)
    proposed = torch.stack((state["action"], AWAY.expand(3, 6)), dim=1)
    stepped = env.step(state.set("tried_action", proposed))
    assert stepped["next", "tried_reward"].shape == (3, 2, 1)
    assert stepped["next", "tried_reward"].isnan().all()
    expert = ExpertPolicy(env.objects, horizon=env.horizon, action_space=env.actions)
    last = expert(step_mdp(stepped))
    last.set("tried_action", torch.stack((last["action"], AWAY.expand(3, 6)), dim=1))
    expected = env.try_last_actions(last["tried_action"])
    ended = env.step(last)
    assert torch.equal(ended["next", "tried_reward"].squeeze(-1), expected.float())
    assert expected.any() and not expected.all()
    # What was proposed for an episode that is over is not tried.
    assert (
        env.step(step_mdp(ended).update(last.select("action", "tried_action")))["next", "tried_reward"]
        .isnan()
        .all()
    )


def test_trying_proposals_leaves_the_episode_as_it_is():
    rewards = []
    for tries in (0, 2):
        env = make_env(3, horizon=22, objects=OBJECTS)
        state = drive(env, 21)
        if tries:
            state.set("tried_action", AWAY.expand(3, tries, 6).clone())
        rewards.append(env.step(state)["next", "reward"])
    assert torch.equal(*rewards) and rewards[0].any()


def test_proposals_of_another_shape_are_refused():
    """At any step, for the last one comes late."""
    env = make_env(2, horizon=3, objects=OBJECTS)
    state = env.reset().set("action", torch.zeros(2, 6))
    with pytest.raises(ConfigError, match=r"give \(N, M, A\), here \(2, M, 6\)"):
        env.step(state.set("tried_action", torch.zeros(2, 3, 7)))
