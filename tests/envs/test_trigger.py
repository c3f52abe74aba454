"""Grasping as soon as the target is between the fingers."""

import numpy as np
import torch

from torchgrasp.envs import GraspEnv
from torchgrasp.envs.trigger import is_between_fingers
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.sim import CameraIntrinsics, RaycastCamera

OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100)


def back(pose: np.ndarray, distance: float) -> np.ndarray:
    out = pose.copy()
    out[:3, 3] -= distance * pose[:3, 2]
    return out


def test_at_most_grasps_the_target_is_between_the_fingers_and_behind_them_never():
    for target in OBJECTS:
        grasps = target.grasps.astype(np.float64)
        inside = [is_between_fingers(target, np.eye(4), grasp) for grasp in grasps]
        assert np.mean(inside) > 0.6
        assert not any(is_between_fingers(target, np.eye(4), back(grasp, 0.06)) for grasp in grasps[:20])


def test_an_episode_ends_when_the_hand_is_there():
    env = GraspEnv(
        4,
        objects=OBJECTS,
        camera=RaycastCamera(CameraIntrinsics(4, 4)),
        grasp_trigger="between_fingers",
        seed=0,
    )
    torch.set_num_threads(1)
    expert = ExpertPolicy(OBJECTS, horizon=env.horizon)
    steps = env.rollout(30, expert, break_when_any_done=False, break_when_all_done=True)
    lengths = steps["next", "done"].squeeze(-1).int().argmax(-1) + 1
    assert lengths.min() < 30
    assert steps["next", "reward"].sum() >= 3
