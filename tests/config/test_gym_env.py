"""Gymnasium's id: the environment of a trained policy, checked by Gymnasium itself."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from tensordict import TensorDict

import torchgrasp
from torchgrasp.objects import ProceduralObjects

OBJECTS = ProceduralObjects("test", num_objects=2, num_grasps=100)


@pytest.fixture(scope="module")
def policy():
    torch.set_num_threads(1)
    return torchgrasp.load_policy("pretrained")


def test_gymnasiums_checker_is_content(policy):
    env = gymnasium.make("torchgrasp.envs.gym:torchgrasp/Grasp-v0", policy=policy, objects=OBJECTS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Points and joints have no bounds, which is what the checker's one warning here is about.
        warnings.filterwarnings("ignore", message=".*(infinity|inf).*")
        check_env(env.unwrapped)


def test_the_policy_acts_as_in_torchrl(policy):
    env = gymnasium.make("torchgrasp.envs.gym:torchgrasp/Grasp-v0", policy=policy, objects=OBJECTS)
    same = torchgrasp.make_env(policy, objects=OBJECTS, seed=11)
    steps = same.rollout(same.horizon, policy)[0]
    observation, info = env.reset(seed=11)
    for step in steps:
        state = {key: torch.from_numpy(observation[key])[None] for key in policy.in_keys}
        action = policy(TensorDict(state, [1]))["action"][0].numpy()
        assert np.allclose(action, step["action"].numpy(), atol=1e-6)
        observation, reward, terminated, _, info = env.step(action)
    assert terminated and reward == steps["next", "reward"].sum() and info["success"] == (reward > 0)
