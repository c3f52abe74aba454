"""suite=agent: GraspAgent beside the environment: the same actions, its time, and another camera."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from torchrl.envs.utils import step_mdp

import torchgrasp
from torchgrasp import GraspAgent, keys
from torchgrasp.evaluation import SuccessTable
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import RaycastCamera

# As wide as an Intel RealSense D435's depth at its usual size.
_WIDE = CameraIntrinsics(848, 480, fx=424 / np.tan(np.radians(69) / 2))


def benchmark_agent(cfg: DictConfig) -> list[dict]:
    """A row of agreement for each motion, one of the time of `act`, and one of success for each camera."""
    options = cfg.agent
    policy = torchgrasp.load_policy(str(options.policy))
    objects = ProceduralObjects("val", num_objects=options.objects)
    rows = [_compare(policy, objects, motion, options) for motion in ("static", "jitter", "handover")]
    rows.append(_time(policy, objects, options))
    training = RaycastCamera()
    for name, camera in (("of training", training), ("848 x 480, 69 degrees wide", RaycastCamera(_WIDE))):
        rows.append({"camera": name, **_succeed(policy, objects, camera, options)})
        rate, (low, high) = rows[-1]["success_rate"], rows[-1]["success_ci95"]
        print(f"camera {name}: {rate:.1%} [{low:.1%}, {high:.1%}] of {rows[-1]['episodes']}", flush=True)
    return rows


def _compare(policy: Any, objects: Any, motion: Any, options: DictConfig) -> dict:
    """The largest difference between the actions of agent and environment over whole episodes."""
    worlds = options.worlds
    env = torchgrasp.make_env(policy, objects=objects, num_envs=worlds, seed=0, target_motion=motion)
    lens = _find_lens(env)
    agent = GraspAgent(policy, intrinsics=lens, thin=1, num_arms=worlds, holes_are_empty=True)
    largest, steps, refused = 0.0, 0, 0
    for _ in range(-(-options.episodes // worlds)):
        state: Any = env.reset()
        agent.reset()
        for _ in range(env.horizon):
            state = policy(state)
            command = agent.act(**_shown(state), T_base_camera=state[keys.T_BASE_CAMERA].numpy())
            acts = [problem is None for problem in command.problems]
            off = np.abs(command.action - state[keys.ACTION].numpy())[acts]
            largest, steps = max(largest, float(off.max(initial=0.0))), steps + sum(acts)
            refused += worlds - sum(acts)
            state = step_mdp(env.step(state))
    row = {"motion": motion, "steps": steps, "refused": refused, "largest_difference": largest}
    print(
        f"{motion}: actions of {steps} steps differ by {largest:.1e} at most; {refused} refused", flush=True
    )
    return row


def _find_lens(env: Any) -> CameraIntrinsics:
    """The intrinsics of an environment's wrist camera."""
    return env.base_env.cameras["camera"].intrinsics


def _shown(state: Any) -> dict[str, Any]:
    """What a camera and an arm tell of a state (N)."""
    names = {"depth": keys.DEPTH, "mask": keys.MASK, "joints": keys.JOINTS, "T_base_ee": keys.T_BASE_EE}
    return {name: state[key].numpy() for name, key in names.items()}


def _time(policy: Any, objects: Any, options: DictConfig) -> dict:
    """Milliseconds of `act` of one arm on one core, over whole episodes."""
    env = torchgrasp.make_env(policy, objects=objects, num_envs=1, seed=0)
    lens = _find_lens(env)
    agent = GraspAgent(policy, intrinsics=lens, T_ee_camera=RaycastCamera().T_ee_camera)
    spent, points = [], 0
    for _ in range(options.timed):
        state: Any = env.reset()
        agent.reset()
        for _ in range(env.horizon):
            shown = {name: each[0] for name, each in _shown(state).items()}
            started = time.perf_counter()
            command = agent.act(**shown)
            spent.append(1e3 * (time.perf_counter() - started))
            points = int(command.num_points)
            state[keys.ACTION] = torch.from_numpy(command.action)[None]
            state = step_mdp(env.step(state))
    median, p95 = np.percentile(spent, (50, 95)).tolist()
    print(f"act on one core: {median:.1f} ms (95 %: {p95:.1f}) over {len(spent)} steps", flush=True)
    return {"act_milliseconds": median, "act_milliseconds_p95": p95, "steps": len(spent), "points": points}


def _succeed(policy: Any, objects: Any, camera: RaycastCamera, options: DictConfig) -> dict:
    """Success with a camera, the agent told no more than its intrinsics and its place on the hand."""
    worlds, table = options.worlds, SuccessTable()
    env = torchgrasp.make_env(
        policy, objects=objects, num_envs=worlds, seed=0, camera=camera, object_order="cycle"
    )
    agent = GraspAgent(policy, intrinsics=camera.intrinsics, T_ee_camera=camera.T_ee_camera, num_arms=worlds)
    for _ in range(-(-options.scenes // worlds)):
        state: Any = env.reset()
        reward = np.zeros(worlds)
        agent.reset()
        for _ in range(env.horizon):
            shown = _shown(state)
            del shown["T_base_ee"]  # it follows from the joints
            state[keys.ACTION] = torch.from_numpy(agent.act(**shown).action)
            stepped = env.step(state)
            reward += stepped["next", "reward"].numpy()[:, 0]
            state = step_mdp(stepped)
        for row, number in enumerate(state[keys.OBJECT_ID].flatten().tolist()):
            table.add(objects.names[number], bool(reward[row] > 0))
    summary = table.summary()
    return {key: summary[key] for key in ("success_rate", "success_ci95", "episodes")}
