"""Environments for worker processes: a module of its own, so that spawned workers can import it."""

from __future__ import annotations

import torch
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, AppendGripperPoints, DepthToPoints, SamplePoints


def make_env(num_envs: int = 1, *, first_world: int = 0, horizon: int = 3) -> GraspEnv:
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=2, num_grasps=100)
    camera = RaycastCamera(CameraIntrinsics(16, 16))
    return GraspEnv(
        num_envs, objects=objects, camera=camera, horizon=horizon, first_world=first_world, seed=0
    )


def make_cloud_env(num_envs: int = 1, *, first_world: int = 0, horizon: int = 3) -> TransformedEnv:
    chain = Compose(DepthToPoints(), AggregatePoints(max_points=500), SamplePoints(32), AppendGripperPoints())
    return TransformedEnv(make_env(num_envs, first_world=first_world, horizon=horizon), chain)
