"""Episodes inside rollouts: their outcome on each of their steps, and one by one."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp import keys


def label_episode_success(trajectories: TensorDictBase) -> TensorDictBase:
    """Write `episode_success` (*, T, 1) bool into trajectories (*, T): r_T of the episode, Eq. (5).

    An episode ends where ("next", "done") holds, and succeeded if its reward there is above 0.5.
    Steps of an episode that the rollout cuts off before its end are False.

    >>> from tensordict import TensorDict
    >>> reward, done = torch.tensor([0.0, 1, 0, 0, 0]), torch.tensor([0, 1, 0, 1, 0]).bool()
    >>> steps = TensorDict({"next": {"reward": reward[:, None], "done": done[:, None]}}, [5])
    >>> label_episode_success(steps)["episode_success"].squeeze(-1).tolist()
    [True, True, False, False, False]
    """
    return trajectories.set(keys.EPISODE_SUCCESS, find_outcomes(trajectories)[1].unsqueeze(-1))


def find_outcomes(trajectories: TensorDictBase) -> tuple[Tensor, Tensor]:
    """For each step of (*, T): the step at which its episode ends, the last of all where none does, and r_T.

    Returns:
        end: (*, T) int64.
        success: (*, T) bool; see `label_episode_success`.
    """
    done = trajectories["next", "done"].squeeze(-1)
    success = (trajectories["next", "reward"].squeeze(-1) > 0.5) & done
    end, ended = _find_ends(done)
    return end, success.gather(-1, end) & ended


def split_episodes(trajectories: TensorDictBase) -> list[TensorDictBase]:
    """Complete episodes (T_i) in trajectories (*, T), row by row in order of time.

    Padding (see `get_mask`) and steps after the last ("next", "done") of a row are left out.
    """
    episodes = []
    for row in trajectories.reshape(-1, trajectories.shape[-1]).unbind(0):
        row = row[get_mask(row)]
        start = 0
        for end in row["next", "done"].squeeze(-1).nonzero().squeeze(-1).tolist():
            episodes.append(row[start : end + 1])
            start = end + 1
    return episodes


def get_mask(trajectories: TensorDictBase) -> Tensor:
    """(*, T) bool: steps that are no padding, as TorchRL's `split_trajectories` and collectors mark them."""
    for key in (("collector", "mask"), "mask"):
        mask = trajectories.get(key, None)
        if mask is not None:
            return mask.reshape(trajectories.shape)
    return torch.ones(trajectories.shape, dtype=torch.bool, device=trajectories.device)


def _find_ends(done: Tensor) -> tuple[Tensor, Tensor]:
    """For each step of (*, T): the step at which its episode ends, and whether it does."""
    num_steps = done.shape[-1]
    steps = torch.arange(num_steps, device=done.device).expand_as(done)
    ends = torch.where(done, steps, num_steps)
    ends = ends.flip(-1).cummin(-1).values.flip(-1)
    return ends.clamp_max(num_steps - 1), ends < num_steps
