"""Scenes that tests of planning share."""

import numpy as np

from torchgrasp.envs import StartPoses, StaticTarget
from torchgrasp.envs.scene import Scene, SceneSampler
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import Physics

OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100)


def draw_scenes(count: int) -> list[Scene]:
    sampler = SceneSampler(OBJECTS, physics=Physics(), start=StartPoses(), motion=StaticTarget())
    return [sampler.sample(0, 0, episode) for episode in range(count)]


def resting(index: int, x: float, y: float) -> np.ndarray:
    pose = OBJECTS[index].resting_poses[0].astype(np.float64)
    pose[:2, 3] = x, y
    return pose
