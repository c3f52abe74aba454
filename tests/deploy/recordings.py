"""Real rollouts of one arm, as a camera and an arm tell of them, beside what GraspAgent answered."""

from dataclasses import dataclass

import numpy as np
import torch
from torchrl.envs.utils import step_mdp

import torchgrasp
from tests.deploy.pretrained import policy
from torchgrasp import keys
from torchgrasp.deploy import GraspAgent, GraspCommand
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import RaycastCamera


@dataclass
class Recording:
    """Episodes of pictures with what the agent said to each, and the states that the policy read."""

    episodes: list[list[tuple[dict, GraspCommand]]]
    states: list


def record(*, camera=None, episodes=2, motion="static", spoil=lambda shown: shown, **options) -> Recording:
    """Run the agent in closed loop; `spoil` changes what it is shown."""
    objects = ProceduralObjects("val", num_objects=3, num_grasps=100)
    camera = RaycastCamera() if camera is None else RaycastCamera(camera)
    env = torchgrasp.make_env(
        policy(), objects=objects, num_envs=1, seed=4, camera=camera, target_motion=motion
    )
    agent = GraspAgent(policy(), intrinsics=camera.intrinsics, T_ee_camera=camera.T_ee_camera, **options)
    recording = Recording([], [])
    for _ in range(episodes):
        state = env.reset()
        agent.reset()
        recording.episodes.append([])
        for _ in range(env.horizon):
            recording.states.append({name: state[name].clone() for name in policy().in_keys})
            names = {"depth": keys.DEPTH, "mask": keys.MASK, "joints": keys.JOINTS}
            shown = spoil({name: state[key][0].numpy().copy() for name, key in names.items()})
            command = agent.act(**shown)
            recording.episodes[-1].append((shown, command))
            state["action"] = torch.from_numpy(command.action)[None]
            state = step_mdp(env.step(state))
    return recording


WIDE = CameraIntrinsics(848, 480, fx=424 / np.tan(np.radians(69) / 2), cx=430.0, cy=236.0)
