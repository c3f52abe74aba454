"""What an evaluation counts: the first scenes, in order, whoever runs them."""

import functools
from typing import Any

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn

from torchgrasp.envs import GraspEnv
from torchgrasp.evaluation.success_rate import evaluate_policy
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.rollouts import SerialPool
from torchgrasp.rollouts.episode_pool import copy_for_rollouts
from torchgrasp.sim import CameraIntrinsics, MujocoEngine, RaycastCamera

OBJECTS = ProceduralObjects("train", num_objects=2, num_grasps=100)
STAND = TensorDictModule(lambda time_left: torch.zeros(*time_left.shape[:-1], 6), ["time_left"], ["action"])


def make_env(num_envs: int, horizon: int, **options: Any) -> GraspEnv:
    camera = RaycastCamera(CameraIntrinsics(width=12, height=12))
    return GraspEnv(num_envs, objects=OBJECTS, camera=camera, horizon=horizon, seed=0, **options)


@pytest.fixture(scope="module")
def pool():
    with SerialPool({"test": functools.partial(make_env, 2, 3)}) as made:
        yield made


def test_as_many_episodes_as_asked_for(pool):
    watched = []
    table = evaluate_policy(
        pool,
        STAND,
        num_episodes=3,
        num_envs=2,
        description="standing still",
        by={"worlds": lambda episode: f"world {episode.world}"},
        watch=[watched.append],
    )
    assert [(each.number, each.world) for each in watched] == [(0, 0), (0, 1), (1, 0)]
    assert (table["episodes"], table["success_rate"], table["env_steps"]) == (3, 0.0, 9)
    assert table["failures"] == {"the fingers closed on nothing": 3}
    assert {name: row["episodes"] for name, row in table["worlds"].items()} == {"world 0": 2, "world 1": 1}
    assert sum(row["episodes"] for row in table["objects"].values()) == 3


def test_success_is_what_the_environment_pays():
    """The numbers of the table are those of the episodes that it was made of."""
    watched = []
    with SerialPool({"test": functools.partial(make_env, 2, 20)}) as pool:
        expert = ExpertPolicy(OBJECTS, horizon=20)
        table = evaluate_policy(
            pool, expert, num_episodes=4, num_envs=2, description="expert", watch=[watched.append]
        )
    rewards = [float(each.steps["next", "reward"].sum()) for each in watched]
    assert 0 < sum(rewards) == table["success_rate"] * 4
    assert sum(table["failures"].values()) == 4 - sum(rewards)


def test_a_copy_acts_and_the_original_stays_in_training():
    policy = nn.Sequential(nn.Linear(2, 2), nn.Dropout())
    copy = copy_for_rollouts(policy)
    assert policy.training and not copy.training
    with torch.no_grad():
        policy[0].weight.zero_()
    assert bool((copy[0].weight != 0).any())


def test_what_is_no_module_acts_itself():
    def act(tensordict):
        return tensordict

    assert copy_for_rollouts(act) is act


def test_an_episode_whose_physics_breaks_is_a_failure_and_the_others_go_on():
    """Contacts that resist turning beyond all measure: in some scenes MuJoCo finds no solution."""
    engine, watched = MujocoEngine(substeps=1, torsion=1e6, impratio=1e10), []
    with SerialPool({"test": functools.partial(make_env, 3, 5, engine=engine)}) as pool:
        table = evaluate_policy(
            pool, STAND, num_episodes=6, num_envs=3, description="broken", watch=[watched.append]
        )
    broken = [each for each in watched if each.failure == "the physics became unstable"]
    assert table["failures"]["the physics became unstable"] == len(broken)
    assert table["episodes"] == 6 and len(broken) > 0
    for each in watched:
        assert len(each.steps) == 5 or each.failure == "the physics became unstable"
        assert each.steps["next", "joints"].isfinite().all() and each.steps["next", "done"].sum() == 1
