"""Collecting demonstrations: the same shards however it is done, and an end where there is no hope."""

import functools

import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.data import CompactTransitions, open_demonstrations
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy, RandomAction
from torchgrasp.rollouts import ProcessPool, SerialPool, collection
from torchgrasp.rollouts.collection import SHARD_ROUNDS, collect_demonstrations
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import DepthToPoints, SamplePoints

NUM_ENVS = 2
ATTEMPTS = SHARD_ROUNDS * NUM_ENVS  # of a shard
OBJECTS = ProceduralObjects("train", num_objects=2, num_grasps=100)
RANDOM = RandomAction(seed=4)
STAND = TensorDictModule(lambda time_left: torch.zeros(*time_left.shape[:-1], 6), ["time_left"], ["action"])


def make_env(horizon: int = 3) -> TransformedEnv:
    camera = RaycastCamera(CameraIntrinsics(width=24, height=24))
    env = GraspEnv(NUM_ENVS, objects=OBJECTS, camera=camera, horizon=horizon, seed=0)
    return TransformedEnv(env, Compose(DepthToPoints(), SamplePoints(16)))


@pytest.fixture(scope="module")
def alone():
    with SerialPool({"train": make_env}) as pool:
        yield pool


def collect(pool, path, *, policy=RANDOM, kind="learner", num_steps=1, **options):
    codec = CompactTransitions(gripper_points=False)
    card = collect_demonstrations(
        pool, policy, path, kind=kind, num_steps=num_steps, codec=codec, seed=0, **options
    )
    opened = open_demonstrations(path)
    assert card == opened.card
    return opened


def assert_same(ours, theirs):
    assert ours.records == theirs.records and ours.num_shards == theirs.num_shards
    for rows, others in zip(ours.shards, theirs.shards, strict=True):
        assert set(rows.keys()) == set(others.keys()) and bool((rows == others).all())


def test_whole_shards_until_there_are_enough_steps(alone, tmp_path):
    opened = collect(alone, tmp_path / "demos", num_steps=3 * ATTEMPTS + 1, provenance={"seed": 0})
    assert (opened.num_shards, opened.num_episodes, opened.card["steps"]) == (2, 2 * ATTEMPTS, 6 * ATTEMPTS)
    assert opened.card["attempts"] == 2 * ATTEMPTS and opened.card["provenance"] == {"seed": 0}


def test_what_was_stopped_goes_on_to_the_same_shards(alone, tmp_path):
    collect(alone, tmp_path / "parts")
    parts = collect(alone, tmp_path / "parts", num_steps=9 * ATTEMPTS)
    assert_same(parts, collect(alone, tmp_path / "whole", num_steps=9 * ATTEMPTS))
    assert parts.num_shards == 3


def test_workers_change_no_shard(alone, tmp_path):
    """More of them than a shard has rounds, so that several shards are run at once."""
    with ProcessPool({"train": make_env}, num_workers=1) as pool:
        ours = collect(pool, tmp_path / "ours", num_steps=9 * ATTEMPTS, num_workers=SHARD_ROUNDS + 1)
    assert_same(ours, collect(alone, tmp_path / "theirs", num_steps=9 * ATTEMPTS))


def test_nothing_is_run_where_enough_is_there(alone, tmp_path):
    first = collect(alone, tmp_path / "demos")

    def refuse(_):
        raise AssertionError("this policy must not be asked")

    assert_same(collect(alone, tmp_path / "demos", policy=refuse), first)


def test_of_the_kind_failed_successes_are_left_out(tmp_path):
    """The expert in episodes of even number, a hand that stands still in the others."""
    stand = TensorDictModule(
        lambda action, episode: action * (1 - episode % 2), ["action", "episode"], ["action"]
    )
    policy = TensorDictSequential(ExpertPolicy(OBJECTS, horizon=15), stand)
    with SerialPool({"train": functools.partial(make_env, 15)}) as pool:
        every = collect(pool, tmp_path / "every", policy=policy, count="all").card
        failed = collect(pool, tmp_path / "failed", policy=policy, kind="failed")
    assert 0 < every["successes"] <= every["attempts"] / 2
    assert failed.card["attempts"] == every["attempts"] == ATTEMPTS
    assert failed.num_episodes == ATTEMPTS - every["successes"] and failed.card["successes"] == 0
    actions = torch.cat([rows["action"] for rows in failed.iterate_rows()])
    assert len(actions) == failed.card["failed_steps"] == failed.card["steps"]


def test_without_hope_it_ends(alone, tmp_path, monkeypatch):
    monkeypatch.setattr(collection, "_HOPELESS", 2 * ATTEMPTS)
    with pytest.raises(ConfigError, match=f"No step of {2 * ATTEMPTS} episodes counts: give more steps"):
        collect(alone, tmp_path / "demos", policy=STAND, kind="expert")
    assert open_demonstrations(tmp_path / "demos").num_shards == 2  # kept, and there to look at
