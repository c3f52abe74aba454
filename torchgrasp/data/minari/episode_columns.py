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
from torchgrasp.data.foreign_columns import check_end, read_column
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


def columns_to_rows(episode: Any, codec: CompactTransitions, *, ours: bool) -> TensorDict:
    """One of Minari's episodes to rows (R); labels that it lacks are stored as absent.

    An episode whose last step is not marked as terminated was truncated there. ConfigError names
    the episode and the column that has a wrong shape, holds no finite numbers, or ends too early.

    Args:
        episode: a minari EpisodeData whose observations are a dictionary.
        codec: whose observations are wanted.
        ours: whether an export made it: infos besides the labels are kept then (a dot in their names
            separates nested keys), and time_left may be what was stored.
    """
    num_steps, terminated = len(episode.rewards), _read_ends(episode)
    rows_of_step = torch.arange(num_steps + int(not bool(terminated[-1]))).clamp_max(num_steps - 1)
    num_rows = len(rows_of_step)
    rows = TensorDict({}, [num_rows])
    for name in codec.observation_keys:
        rows[name] = _read_observation(episode, name, codec, unit_time=not ours)[:num_rows]
    action = _read(episode, "actions", shape=(ACTION_SIZE,), dtype=torch.float32)
    rows[keys.ACTION] = action[rows_of_step]
    for name, value in _read_infos(episode, num_rows, extras=ours).items():
        rows[name] = value
    rewards = _read(episode, "rewards", shape=(1,), dtype=torch.float32)
    done = terminated.clone()
    done[-1] = True
    outcomes = {"reward": rewards, "terminated": terminated, "done": done}
    for name, value in outcomes.items():
        rows[name] = value[rows_of_step]
    rows[keys.EPISODE_SUCCESS] = (rewards[-1:] > 0.5).expand(num_rows, 1).clone()
    return rows.set(STUB, (torch.arange(num_rows) >= num_steps)[:, None])


def _read(episode: Any, name: str, *, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    """One of an episode's columns (T, *shape)."""
    lengths = [len(episode.rewards)]
    return read_column(
        getattr(episode, name), _told(episode, name), lengths=lengths, shape=shape, dtype=dtype
    )


def _told(episode: Any, name: str) -> str:
    return f"Episode {episode.id}: {name!r}"


def _read_ends(episode: Any) -> Tensor:
    """(T, 1) bool: whether a step terminated the episode; only the last may end it."""
    if not len(episode.rewards):
        raise ConfigError(f"Episode {episode.id} has no step: leave it out.")
    flags = {
        name: _read(episode, name, shape=(1,), dtype=torch.bool) for name in ("terminations", "truncations")
    }
    for name, flag in flags.items():
        check_end(flag, _told(episode, name))
    return flags["terminations"]


def _read_infos(episode: Any, num_rows: int, *, extras: bool) -> dict[NestedKey, Tensor]:
    """Labels (R, ...), and with `extras` the other infos."""
    infos: Mapping[str, Any] = episode.infos or {}
    lengths = {num_rows, len(episode.rewards) + 1}
    columns: dict[NestedKey, Tensor] = {}
    for name, default in default_labels().items():
        told, given = _told(episode, join_key(name)), infos.get(join_key(name))
        columns[name] = (
            default.expand(num_rows, *default.shape).clone()
            if given is None
            else read_column(given, told, lengths=lengths, shape=tuple(default.shape), dtype=default.dtype)
        )[:num_rows]
    known = {keys.EPISODE_SUCCESS, *map(join_key, default_labels())}
    for name in set(infos) - known if extras else ():
        columns[_split_key(name)] = read_column(infos[name], _told(episode, name), lengths=lengths)[:num_rows]
    return columns


def _read_observation(episode: Any, name: NestedKey, codec: CompactTransitions, *, unit_time: bool) -> Tensor:
    """(T + 1, ...) values of an observation as the codec stores them."""
    states, told = episode.observations, _told(episode, join_key(name))
    if not isinstance(states, Mapping) or join_key(name) not in states:
        found = sorted(states) if isinstance(states, Mapping) else type(states).__name__
        raise ConfigError(
            f"The dataset's observations have no {join_key(name)!r}, only {found}: demonstrations need "
            f"{[join_key(each) for each in codec.observation_keys]}."
        )
    given, lengths = states[join_key(name)], [len(episode.rewards) + 1]
    if name == codec.points_key:
        points = read_column(given, told, lengths=lengths, dtype=torch.float16)
        if points.ndim != 3 or (codec.gripper_points and points.shape[-1] != 3):
            raise ConfigError(
                f"{told} of shape {tuple(points.shape)}: expected clouds (T + 1, N, 3) without "
                "the gripper's points, or CompactTransitions(gripper_points=False) for others."
            )
        return points
    if name != keys.TIME_LEFT:
        return read_column(given, told, lengths=lengths)
    left = read_column(given, told, lengths=lengths, shape=(1,), dtype=torch.float32)
    if unit_time and not bool(((left >= 0) & (left <= 1)).all()):
        raise ConfigError(f"{told} is out of range: give the share of the steps that is left, in [0, 1].")
    return left


def _split_key(name: str) -> NestedKey:
    return tuple(name.split(".")) if "." in name else name
