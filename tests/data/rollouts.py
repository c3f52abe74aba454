"""Rollouts whose numbers tell which state is which."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from torchgrasp.data import append_shard, split_episodes
from torchgrasp.geometry import gripper_control_points


def make_cloud(state: torch.Tensor, num_points: int = 8) -> torch.Tensor:
    """(*, N + 6, 4) clouds that differ from state to state; float16 holds them exactly."""
    cloud = torch.zeros(*state.shape, num_points + 6, 4)
    offset = torch.arange(num_points * 3).reshape(num_points, 3) / 64
    cloud[..., :num_points, :3] = (state % 512)[..., None, None] / 64 + offset
    cloud[..., num_points:, :3] = gripper_control_points()
    cloud[..., num_points:, 3] = 1.0
    return cloud


def make_rollout(
    num_envs: int,
    num_steps: int,
    *,
    generator: torch.Generator,
    first_state: int = 0,
    done_rate: float = 0.15,
    truncated_rate: float = 0.3,
) -> TensorDict:
    """(B, T) steps as a collector gives them; `time_left` numbers the states, no number used twice.

    A step's next state is numbered one higher; after an end the environment goes on elsewhere.
    """
    shape = (num_envs, num_steps)
    done = torch.rand(shape, generator=generator) < done_rate
    truncated = done & (torch.rand(shape, generator=generator) < truncated_rate)
    jumps = torch.cat((torch.zeros(num_envs, 1), done[:, :-1].cumsum(1)), dim=1)
    steps = torch.arange(num_steps) + jumps + torch.arange(num_envs)[:, None] * 2 * (num_steps + 1)
    state = steps + first_state
    return make_steps(state, done, truncated, generator)


def make_steps(
    state: torch.Tensor, done: torch.Tensor, truncated: torch.Tensor, generator: torch.Generator
) -> TensorDict:
    shape = state.shape
    outcome = {
        "done": done[..., None],
        "terminated": (done & ~truncated)[..., None],
        "truncated": truncated[..., None],
        "reward": (done & ~truncated)[..., None].float() * torch.randint(2, (*shape, 1), generator=generator),
    }
    root = {
        "points": make_cloud(state),
        "time_left": state[..., None].float(),
        "action": torch.randn(*shape, 6, generator=generator),
        "expert_action": torch.randn(*shape, 6, generator=generator),
        "goal": torch.randn(*shape, 7, generator=generator),
        "has_expert": torch.rand(*shape, 1, generator=generator) < 0.5,
        "has_goal": torch.rand(*shape, 1, generator=generator) < 0.5,
        "perturbed": torch.rand(*shape, 1, generator=generator) < 0.1,
    }
    following = {"points": make_cloud(state + 1), "time_left": state[..., None].float() + 1, **outcome}
    return TensorDict({**root, "next": following}, shape)


def make_episodes(seed: int) -> list:
    return split_episodes(make_rollout(4, 20, generator=torch.Generator().manual_seed(seed)))


def append(path, index: int, episodes: list | None = None) -> dict:
    """Shard `index` of the episodes given, or of those with the index as their seed."""
    episodes = episodes or make_episodes(index)
    names = [("mug", "bowl")[i % 2] for i in range(len(episodes))]
    return append_shard(path, episodes, objects=names, seeds=range(len(episodes)), index=index)
