import functools

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy, RandomAction
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.training import EpisodePool
from torchgrasp.transforms import AggregatePoints, DepthToPoints, SamplePoints

HORIZON = 5


def make_objects():
    return ProceduralObjects("train", num_objects=2, num_grasps=100)


def make_env(num_envs: int = 2):
    camera = RaycastCamera(CameraIntrinsics(width=24, height=24))
    env = GraspEnv(num_envs, objects=make_objects(), camera=camera, horizon=HORIZON)
    return TransformedEnv(env, Compose(DepthToPoints(), AggregatePoints(), SamplePoints(16)))


def die(tensordict):
    import os

    os._exit(3)


def run_all(pool, policy, numbers):
    return [episode for batch in pool.run("env", policy, numbers) for episode in batch]


def test_workers_change_nothing():
    policy = RandomAction(seed=4)
    with EpisodePool({"env": make_env}) as alone, EpisodePool({"env": make_env}, num_workers=2) as pool:
        ours, theirs = run_all(alone, policy, range(3)), run_all(pool, policy, range(3))
        again = run_all(alone, policy, [1])
    assert [(e.world, e.number, e.object_name) for e in ours] == [
        (e.world, e.number, e.object_name) for e in theirs
    ]
    for one, other in zip(ours, theirs, strict=True):
        assert torch.equal(one.steps["points"], other.steps["points"])
        assert torch.equal(one.steps["next", "T_base_ee"], other.steps["next", "T_base_ee"])
    # An episode depends on nothing that ran before it.
    assert torch.equal(again[0].steps["points"], ours[2].steps["points"])


def test_the_number_of_worlds_changes_no_world():
    policy = RandomAction(seed=4)
    with EpisodePool({"env": make_env, "wide": functools.partial(make_env, 3)}) as pool:
        narrow = run_all(pool, policy, range(2))
        wide = [episode for batch in pool.run("wide", policy, range(2)) for episode in batch]
    assert [e.world for e in wide] == [0, 1, 2, 0, 1, 2]
    for one in narrow:
        (other,) = [e for e in wide if (e.world, e.number) == (one.world, one.number)]
        assert torch.equal(one.steps["next", "points"], other.steps["next", "points"])


def test_whole_episodes_with_the_keys_asked_for():
    expert = ExpertPolicy(make_objects(), horizon=HORIZON)
    with EpisodePool({"env": make_env}, keep=["points", "action"]) as pool:
        (episode, _) = run_all(pool, expert, [0])
    assert episode.steps.batch_size == (HORIZON,)
    assert episode.steps["next", "done"].squeeze(-1).tolist() == [False] * (HORIZON - 1) + [True]
    assert set(episode.steps.keys()) == {"points", "action", "next"}


def test_a_dead_worker_is_told_not_waited_for():
    with (
        EpisodePool({"env": make_env}, num_workers=1) as pool,
        pytest.raises(TorchgraspError, match="worker"),
    ):
        run_all(pool, die, [0])


def test_bad_number_of_workers():
    with pytest.raises(ConfigError, match="num_workers=-1"):
        EpisodePool({"env": make_env}, num_workers=-1)
