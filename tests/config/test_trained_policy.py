"""The Python face: a policy and the environment that it was trained in."""

import pytest
import torch

import torchgrasp
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.transforms import AggregatePoints, TablePlane, WristAngle

OBJECTS = ProceduralObjects("test", num_objects=2, num_grasps=100)


@pytest.fixture(scope="module")
def policy():
    torch.set_num_threads(1)
    return torchgrasp.load_policy("pretrained")


def test_the_environment_is_the_one_that_the_policy_knows(policy):
    env = torchgrasp.make_env(policy, objects=OBJECTS, num_envs=2, seed=3)
    kinds = {type(each): each for each in env.transform}
    assert {AggregatePoints, TablePlane, WristAngle} <= set(kinds)
    assert kinds[AggregatePoints].carve == policy.config["transforms"]["aggregate"]["carve"] is not None
    assert env.horizon == policy.horizon == 30
    state = env.reset()
    assert all(key in state.keys(True, True) for key in policy.in_keys)


def test_the_policy_acts_in_it_and_lifts_most(policy):
    env = torchgrasp.make_env(policy, objects=OBJECTS, num_envs=4, seed=5, object_order="cycle")
    steps = env.rollout(env.horizon, policy)
    assert steps["action"].shape == (4, 30, 6)
    assert steps["next", "reward"].sum() >= 2  # of four; the test split's rate is above nine in ten


def test_a_name_is_enough(policy):
    env = torchgrasp.make_env("pretrained", objects=OBJECTS)
    assert env.batch_size == torch.Size([1])


def test_misuse_is_told(tmp_path):
    with pytest.raises(ConfigError, match=r"^source='nobody' is not there"):
        torchgrasp.load_policy("nobody")
    with pytest.raises(ConfigError, match=r"holds no weights\.safetensors"):
        torchgrasp.load_policy(tmp_path)


def test_it_stands_in_the_other_physics_as_well(policy):
    env = torchgrasp.make_env(policy, objects=OBJECTS, num_envs=4, seed=5, engine="mujoco")
    steps = env.rollout(env.horizon, policy)
    assert env.base_env.worlds.engine.name == "mujoco" and steps["next", "reward"].sum() >= 2
