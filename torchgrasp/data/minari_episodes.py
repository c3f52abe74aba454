"""Episodes as Minari keeps them, from rows of CompactTransitions and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.data.compact import CompactTransitions, default_labels
from torchgrasp.data.sampler import STUB
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_SIZE

_OUTCOMES = ("reward", "terminated", "done")


def make_space(rows: TensorDictBase, names: Sequence[NestedKey]) -> Any:
    """The gymnasium Dict space of the columns `names`, bounded by their types alone."""
    from gymnasium import spaces

    space: dict[str, Any] = {}
    for name in names:
        value: Any = rows[name].numpy()
        space[join_key(name)] = spaces.Box(
            *_find_bounds(value.dtype), shape=value.shape[1:], dtype=value.dtype
        )
    return spaces.Dict(space)


def _find_bounds(dtype: Any) -> tuple[float, float]:
    if dtype.kind == "f":
        return -np.inf, np.inf
    return (0, 1) if dtype.kind == "b" else (np.iinfo(dtype).min, np.iinfo(dtype).max)


def join_key(name: NestedKey) -> str:
    """A key's name in a Minari dataset."""
    return name if isinstance(name, str) else ".".join(map(str, name))


def rows_to_columns(rows: TensorDictBase, codec: CompactTransitions) -> dict[str, Any]:
    """Rows (R) of one episode to the T steps and T + 1 states that Minari's EpisodeBuffer takes."""
    truncated = bool(rows[STUB][-1])
    steps: Any = rows[:-1] if truncated else rows
    columns: dict[Any, Any] = {name: rows[name].numpy() for name in rows.keys(True, True)}
    known = {STUB, keys.ACTION, *_OUTCOMES, *codec.observation_keys}
    observations = {join_key(name): columns[name] for name in codec.observation_keys}
    infos = {join_key(name): column for name, column in columns.items() if name not in known}
    if not truncated:
        observations = {name: np.concatenate((each, each[-1:])) for name, each in observations.items()}
        infos = {name: np.concatenate((each, np.zeros_like(each[-1:]))) for name, each in infos.items()}
    reward, terminated, done = (steps[name].squeeze(-1).numpy() for name in _OUTCOMES)
    return {
        "observations": observations,
        "actions": steps[keys.ACTION].numpy(),
        "rewards": reward,
        "terminations": terminated,
        "truncations": done & ~terminated,
        "infos": infos,
    }


def columns_to_rows(episode: Any, codec: CompactTransitions, *, extras: bool) -> TensorDict:
    """One of Minari's episodes to rows (R); labels that it lacks are stored as absent.

    Args:
        episode: a minari EpisodeData whose observations are a dictionary.
        codec: whose observations are wanted.
        extras: whether infos besides the labels are kept; a dot in their names separates nested keys.
    """
    num_steps = len(episode.rewards)
    terminated = _column(episode.terminations).bool()
    rows_of_step = torch.arange(num_steps + int(not bool(terminated[-1]))).clamp_max(num_steps - 1)
    num_rows = len(rows_of_step)
    observations = {name: _get_observation(episode, name, codec) for name in codec.observation_keys}
    rows = TensorDict({name: value[:num_rows] for name, value in observations.items()}, [num_rows])
    action = torch.from_numpy(np.asarray(episode.actions)).float()
    if action.shape != (num_steps, ACTION_SIZE):
        raise ConfigError(
            f"Actions of shape {tuple(action.shape)}: expected relative hand poses (T, {ACTION_SIZE})."
        )
    rows[keys.ACTION] = action[rows_of_step]
    infos: Mapping[str, Any] = episode.infos or {}
    for name, default in default_labels().items():
        given = infos.get(join_key(name))
        rows[name] = _spread(default, num_rows) if given is None else _like(given, default)[:num_rows]
    rewards = _column(episode.rewards).float()
    done = terminated.clone()
    done[-1] = True
    outcomes = {"reward": rewards, "terminated": terminated, "done": done}
    for name, value in outcomes.items():
        rows[name] = value[rows_of_step]
    rows[keys.EPISODE_SUCCESS] = (rewards[-1:] > 0.5).expand(num_rows, 1).clone()
    known = {keys.EPISODE_SUCCESS, *map(join_key, default_labels())}
    for name in set(infos) - known if extras else ():
        rows[_split_key(name)] = torch.from_numpy(np.asarray(infos[name]))[:num_rows]
    return rows.set(STUB, (torch.arange(num_rows) >= num_steps)[:, None])


def _get_observation(episode: Any, name: NestedKey, codec: CompactTransitions) -> Tensor:
    states = episode.observations
    if not isinstance(states, Mapping) or join_key(name) not in states:
        found = sorted(states) if isinstance(states, Mapping) else type(states).__name__
        raise ConfigError(
            f"The dataset's observations have no {join_key(name)!r}, only {found}: demonstrations need "
            f"{[join_key(each) for each in codec.observation_keys]}."
        )
    value = torch.from_numpy(np.asarray(states[join_key(name)]))
    if name != codec.observation_keys[0]:
        return value
    if value.ndim != 3 or (codec.gripper_points and value.shape[-1] != 3):
        raise ConfigError(
            f"{join_key(name)!r} of shape {tuple(value.shape)}: expected clouds (T + 1, N, 3) without "
            "the gripper's points, or CompactTransitions(gripper_points=False) for others."
        )
    return value.half()


def _column(values: Any) -> Tensor:
    return torch.from_numpy(np.asarray(values)).reshape(-1, 1)


def _like(values: Any, default: Tensor) -> Tensor:
    return torch.from_numpy(np.asarray(values)).to(default.dtype).reshape(-1, *default.shape)


def _spread(default: Tensor, num_rows: int) -> Tensor:
    return default.expand(num_rows, *default.shape).clone()


def _split_key(name: str) -> NestedKey:
    return tuple(name.split(".")) if "." in name else name
