"""Every task that GraspEnv offers keeps to TorchRL's contract and to its seed, alone and in company."""

from __future__ import annotations

from functools import partial
from itertools import product

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import ParallelEnv, check_env_specs
from torchrl.envs.utils import step_mdp

from torchgrasp.envs import GraspEnv, HandoverTarget, StartPoses, TabletopStart
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, Physics, RaycastCamera, look_at

HORIZON = 3
MOTIONS = ("static", "jitter", "handover")
ACTIONS = ("ee_delta", "joint_delta", "joint_velocity")
TRIGGERS = ("horizon", "between_fingers")
STARTS = {"facing": StartPoses(), "fixed": TabletopStart(), "varied": TabletopStart(spread=0.25)}
PHYSICS = {"same": Physics(), "varied": Physics(vary={"mass": (0.05, 0.4), "friction": (0.4, 1.2)})}
TASKS = [*product(MOTIONS, ACTIONS, TRIGGERS, STARTS, PHYSICS)]


def make_env(task, num_envs: int = 2, **options) -> GraspEnv:
    motion, actions, trigger, start, physics = task
    torch.set_num_threads(1)
    eye = RaycastCamera(CameraIntrinsics(6, 6), T_base_camera=look_at((1.4, 0.0, 0.9), (0.5, 0.0, 0.15)))
    options = {"seed": 0} | options
    return GraspEnv(
        num_envs,
        objects=ProceduralObjects("train", num_objects=2, num_grasps=100),
        camera=RaycastCamera(CameraIntrinsics(6, 6)),
        overhead=eye,
        horizon=HORIZON,
        start=STARTS[start],
        physics=PHYSICS[physics],
        target_motion=motion,
        action_space=actions,
        grasp_trigger=trigger,
        **options,
    )


def play(env, *, seed: int = 0) -> torch.Tensor:
    """All joints and target poses of one episode of every world, under actions that the world alone fixes."""
    state, seen = env.reset(), []
    size = env.action_spec.shape[-1]
    for step in range(HORIZON):
        rows = []
        for world in state["world"].flatten().tolist():
            generator = torch.Generator().manual_seed(1000 * seed + 10 * world + step)
            rows.append(torch.rand(size, generator=generator) * 0.1 - 0.05)
        action = torch.stack(rows).reshape(env.action_spec.shape)
        state = step_mdp(env.step(state.set("action", action)))
        seen.append(torch.cat((state["joints"].flatten(-1), state["T_base_object"].flatten(-2)), dim=-1))
    return torch.stack(seen).reshape(HORIZON, -1, 25)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: "-".join(map(str, task)))
def test_specs(task):
    check_env_specs(make_env(task), break_when_any_done="both")


@pytest.mark.parametrize("motion", [*MOTIONS, HandoverTarget(route="left_to_right")], ids=str)
@pytest.mark.parametrize("actions", ACTIONS)
def test_worlds_play_the_same_episodes_in_any_batch(motion, actions):
    task = (motion, actions, "between_fingers", "facing", "varied")
    together = play(make_env(task, 3, seed=5))
    for row in range(3):
        assert torch.equal(play(make_env(task, 1, seed=5, first_world=row))[:, 0], together[:, row])


@pytest.mark.parametrize("motion", MOTIONS)
def test_partial_resets_leave_the_others_alone(motion):
    task = (motion, "ee_delta", "horizon", "facing", "varied")
    env, alone = make_env(task, seed=2), make_env(task, seed=2)
    first, second = env.reset(), alone.reset()
    still = torch.zeros(2, 6)
    first, second = (step_mdp(e.step(s.set("action", still))) for e, s in ((env, first), (alone, second)))
    mixed = env.reset(first.set("_reset", torch.tensor([[True], [False]])))
    assert mixed["episode"].flatten().tolist() == [1, 0]
    mixed, second = (step_mdp(e.step(s.set("action", still))) for e, s in ((env, mixed), (alone, second)))
    assert torch.equal(mixed["T_base_object"][1], second["T_base_object"][1])
    assert torch.equal(mixed["joints"][1], second["joints"][1])


@pytest.mark.slow
def test_parallel_workers_play_the_same_episodes():
    task = ("jitter", "ee_delta", "horizon", "facing", "varied")
    makers = [partial(make_env, task, 1, seed=4, first_world=world) for world in range(2)]
    parallel = ParallelEnv(2, makers, mp_start_method="spawn")
    try:
        assert torch.equal(play(parallel), play(make_env(task, 2, seed=4)))
    finally:
        parallel.close()


def test_a_collector_hands_over_every_task():
    task = ("handover", "joint_velocity", "between_fingers", "varied", "varied")
    collector = Collector(
        partial(make_env, task), None, frames_per_batch=2 * HORIZON, total_frames=4 * HORIZON
    )
    batches = list(collector)
    collector.shutdown()
    assert [batch.numel() for batch in batches] == [2 * HORIZON] * 2
    assert batches[0]["action"].shape[-1] == 7


def test_a_cycle_meets_every_object_once_before_any_comes_again():
    objects = ProceduralObjects("train", num_objects=5, num_grasps=100)
    env = GraspEnv(
        2, objects=objects, camera=RaycastCamera(CameraIntrinsics(4, 4)), object_order="cycle", seed=0
    )
    for row in range(2):
        assert sorted(env.scene(row, episode).object_id for episode in range(5)) == list(range(5))
    assert [env.scene(0, i).object_id for i in range(5)] != [env.scene(1, i).object_id for i in range(5)]
