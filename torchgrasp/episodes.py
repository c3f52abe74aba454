"""Episodes inside rollouts: where they go on and end, their outcome on each of their steps, one by one."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.errors import ConfigError

# Numbers that the steps of one trajectory share: TorchRL's collectors write the first two.
_NUMBERS = (("collector", "traj_ids"), "traj_ids", keys.WORLD, keys.EPISODE, keys.SOURCE)


def label_episode_success(trajectories: TensorDictBase) -> TensorDictBase:
    """Write `episode_success` (*, T, 1) bool into trajectories (*, T): r_T of the episode, Eq. (5).

    An episode ends where ("next", "done") holds, and succeeded if its reward there is above 0.5.
    Steps of an episode that is cut off before its end are False (see `find_links`).

    >>> from tensordict import TensorDict
    >>> reward, done = torch.tensor([0.0, 1, 0, 0, 0]), torch.tensor([0, 1, 0, 1, 0]).bool()
    >>> steps = TensorDict({"next": {"reward": reward[:, None], "done": done[:, None]}}, [5])
    >>> label_episode_success(steps)["episode_success"].squeeze(-1).tolist()
    [True, True, False, False, False]
    """
    return trajectories.set(keys.EPISODE_SUCCESS, find_outcomes(trajectories)[1].unsqueeze(-1))


def find_outcomes(trajectories: TensorDictBase) -> tuple[Tensor, Tensor]:
    """For each step of (*, T): the last step of its episode that is there, and r_T.

    Returns:
        end: (*, T) int64.
        success: (*, T) bool; see `label_episode_success`.
    """
    valid, linked = find_links(trajectories)
    done = trajectories["next", "done"].squeeze(-1)
    success = (trajectories["next", "reward"].squeeze(-1) > 0.5) & done & valid
    end = _find_ends(linked)
    return end, success.gather(-1, end)


def find_links(trajectories: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Which steps of (*, T) are no padding, and which are followed by the next step of their episode.

    An episode goes on from a step to the next one of the tensordict unless it is done there, one of
    the two is padding, or they are not of one trajectory (see `find_same`).

    Returns:
        valid: (*, T) bool.
        linked: (*, T) bool; always false at the last step.
    """
    check_trajectories(trajectories)
    done = trajectories["next", "done"].squeeze(-1)
    valid = get_mask(trajectories)
    linked = torch.zeros_like(valid)
    linked[..., :-1] = ~done[..., :-1] & valid[..., :-1] & valid[..., 1:]
    linked[..., :-1] &= find_same(trajectories).to(done.device)
    return valid, linked


def find_same(trajectories: TensorDictBase) -> Tensor:
    """(*, T - 1) bool: which steps of (*, T) bear the numbers of the next step.

    These are ("collector", "traj_ids"), "traj_ids", WORLD, EPISODE and SOURCE, as far as they are there.
    """
    shape = trajectories.shape
    same = torch.ones(*shape[:-1], max(shape[-1] - 1, 0), dtype=torch.bool, device=trajectories.device)
    for key in _NUMBERS:
        number = trajectories.get(key, None)
        if number is not None:
            number = number.reshape(shape)
            same = same.to(number.device) & (number[..., 1:] == number[..., :-1])
    return same


def check_trajectories(trajectories: TensorDictBase) -> None:
    """Raise ConfigError where a tensordict has no dimension of time."""
    if not trajectories.ndim:
        raise ConfigError(
            "A single step was given, of batch size (): give trajectories (*, T), time last, as collectors "
            "and rollouts do; one step alone as `step.unsqueeze(-1)`."
        )


def split_episodes(trajectories: TensorDictBase) -> list[TensorDictBase]:
    """Episodes (T_i) in trajectories (*, T) that have their end, row by row in order of time.

    Padding and steps of which no ("next", "done") is there are left out (see `find_links`).
    """
    episodes = []
    check_trajectories(trajectories)
    for row in trajectories.reshape(-1, trajectories.shape[-1]).unbind(0):
        valid, linked = find_links(row)
        row, linked = row[valid], linked[valid]
        done, start = row["next", "done"].squeeze(-1), 0
        for end in (~linked).nonzero().squeeze(-1).tolist():
            if done[end]:
                episodes.append(row[start : end + 1])
            start = end + 1
    return episodes


def split_tries(steps: TensorDictBase) -> TensorDictBase:
    """Episodes (K, 1) of one step each: what was tried at the end of one with steps (T), and its reward.

    Each is the last step with another action, TRIED_ACTION, whose reward TRIED_REWARD tells. They teach a
    critic: there is no label of them to imitate, and no goal. None where nothing was tried, or where the
    episode ended before.

    >>> from tensordict import TensorDict
    >>> ends = {"reward": torch.ones(1, 1), "done": torch.ones(1, 1, dtype=torch.bool)}
    >>> tried = {"tried_reward": torch.tensor([[[0.0], [torch.nan], [1.0]]])}
    >>> steps = TensorDict({"action": torch.zeros(1, 6), "tried_action": torch.rand(1, 3, 6),
    ...                     "next": {**ends, **tried}}, [1])
    >>> split_tries(steps)["next", "reward"].flatten().tolist()
    [0.0, 1.0]
    """
    last: Any = steps[-1:]
    last = last.exclude(keys.TRIED_ACTION, ("next", keys.TRIED_REWARD))
    actions, rewards = (steps.get(key, None) for key in (keys.TRIED_ACTION, ("next", keys.TRIED_REWARD)))
    if actions is None or rewards is None:
        return last[:0].unsqueeze(-1)
    told = rewards[-1, :, 0].isfinite()
    actions, rewards = actions[-1, told], rewards[-1, told]
    tries = last.expand(len(actions)).clone()
    tries.set(keys.ACTION, actions).set(("next", "reward"), rewards)
    if (after := tries.get(("next", keys.T_BASE_EE), None)) is not None:
        after.fill_(torch.nan)  # nobody has seen where the hand would have been
    absent = torch.zeros(len(actions), 1, dtype=torch.bool, device=rewards.device)
    for key in (keys.HAS_EXPERT, keys.HAS_GOAL, keys.PERTURBED):
        if last.get(key, None) is not None:
            tries.set(key, absent.clone())
        if last.get(("next", key), None) is not None:
            tries.set(("next", key), absent.clone())
    return tries.unsqueeze(-1)


def get_mask(trajectories: TensorDictBase) -> Tensor:
    """(*, T) bool: steps that are no padding, as TorchRL's `split_trajectories` and collectors mark them."""
    for key in (("collector", "mask"), "mask"):
        mask = trajectories.get(key, None)
        if mask is not None:
            return mask.reshape(trajectories.shape)
    return torch.ones(trajectories.shape, dtype=torch.bool, device=trajectories["next", "done"].device)


def _find_ends(linked: Tensor) -> Tensor:
    """For each step of (*, T): the first step from there on that is not `linked` (*, T) to another."""
    num_steps = linked.shape[-1]
    steps = torch.arange(num_steps, device=linked.device).expand_as(linked)
    ends = torch.where(linked, num_steps, steps)
    return ends.flip(-1).cummin(-1).values.flip(-1)
