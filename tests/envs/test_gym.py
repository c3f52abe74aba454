"""Gymnasium's face: its own checker, its seeds, and the same episodes as GraspEnv."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs import Compose, PendulumEnv, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.envs.gym import GymGrasp
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AppendGripperPoints, DepthToPoints, SamplePoints

OBJECTS = ProceduralObjects("train", num_objects=2, num_grasps=100)


def make(horizon: int = 3) -> GymGrasp:
    torch.set_num_threads(1)
    camera = RaycastCamera(CameraIntrinsics(24, 24))
    env = GraspEnv(1, objects=OBJECTS, camera=camera, horizon=horizon, seed=0)
    points = Compose(DepthToPoints(fov=camera.intrinsics.fov), SamplePoints(32), AppendGripperPoints())
    return GymGrasp(TransformedEnv(env, points), observed=("points", "joints", "time_left"))


def test_gymnasiums_checker_is_content():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Points and joints have no bounds, and there is no spec of an id: the checker's two warnings here.
        warnings.filterwarnings("ignore", message=".*(infinity|inf).*|.*render modes.*")
        check_env(make())


def test_an_episode_ends_at_the_horizon_and_tells_of_its_target():
    env = make()
    observation, info = env.reset(seed=3)
    assert observation in env.observation_space and observation["points"].shape == (38, 4)
    assert info["object"] in OBJECTS.names and info["episode"] == 0
    ends = [env.step(env.action_space.sample()) for _ in range(3)]
    assert [terminated for _, _, terminated, _, _ in ends] == [False, False, True]
    assert all(isinstance(reward, float) for _, reward, *_ in ends)
    assert env.reset()[1]["episode"] == 1
    assert env.reset(options={"episode": 7})[1]["episode"] == 7


def test_it_is_the_world_of_graspenv_and_the_expert_succeeds_in_both():
    env = make(horizon=30)
    expert = ExpertPolicy(OBJECTS, horizon=30)
    base = GraspEnv(1, objects=OBJECTS, camera=RaycastCamera(CameraIntrinsics(24, 24)), horizon=30, seed=5)
    steps = base.rollout(30, expert)[0]
    env.reset(seed=5)
    for step in steps:
        observation, reward, terminated, _, info = env.step(step["action"].numpy())
        assert np.array_equal(observation["joints"], step["next", "joints"].numpy())
    assert terminated and reward == steps["next", "reward"].sum() and info["success"] == (reward > 0)


def test_vectorised_by_gymnasium():
    env = gymnasium.vector.SyncVectorEnv([make, make])
    observations, _ = env.reset(seed=[0, 1])
    assert observations["points"].shape == (2, 38, 4)
    env.close()


def test_misuse_is_told():
    with pytest.raises(ConfigError, match="reset"):
        make().step(np.zeros(6))
    env = make()
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="shape"):
        env.step(np.zeros(3))
    with pytest.raises(ConfigError, match="2 worlds"):
        GymGrasp(GraspEnv(2, objects=OBJECTS, horizon=3, seed=0))
    with pytest.raises(ConfigError, match="env is a PendulumEnv: give a GraspEnv"):
        GymGrasp(TransformedEnv(PendulumEnv(), Compose()))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigError, match=r"observed names \['points'\]"):
        GymGrasp(GraspEnv(1, objects=OBJECTS, horizon=3, seed=0), observed=("points",))
