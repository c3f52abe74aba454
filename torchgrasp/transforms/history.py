"""Transforms that remember an episode: a memory for each world, begun anew at its reset."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Generic, Self, TypeVar, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv
from torchrl.envs.transforms import Transform

from torchgrasp.episodes import find_links, find_same
from torchgrasp.errors import ConfigError
from torchgrasp.transforms.base import PointTransform, find_container

Memory = TypeVar("Memory")


class HistoryTransform(PointTransform, Generic[Memory]):
    """A transform whose result depends on what the episode showed before.

    In an environment each world's memory begins anew at its reset, also where the environment resets itself
    (TorchRL's native auto-reset). On a tensordict that is not an environment's, the last batch dimension is
    time, and a memory begins anew where a trajectory ends or another begins (see `find_links`).

    Subclasses write `_begin`, an empty memory, and `_see`, which adds a step to some memories and writes
    `out_keys` from all of them.

    Args:
        in_keys: what is read.
        out_keys: what is written.
        seed: of the draws, see PointTransform.
    """

    def __init__(self, *, in_keys: list, out_keys: list, seed: int = 0) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys, seed=seed)
        self._memories: list[Memory] = []
        # In a tuple, since a module would take it for a part of itself.
        self._cloned_from: tuple[HistoryTransform[Memory], ...] = ()
        self._seen: dict[Any, Tensor] = {}

    def clone(self) -> Self:
        """A copy for another environment, which has seen nothing yet."""
        copied = super().clone()
        copied._memories, copied._cloned_from, copied._seen = [], (self,), {}
        return copied

    @abstractmethod
    def _begin(self) -> Memory:
        """The memory of an episode that has shown nothing yet."""

    @abstractmethod
    def _see(self, tensordict: TensorDictBase, memories: list[Memory], rows: list[int]) -> TensorDictBase:
        """Add the batch elements `rows` to their memories, and write every element's `out_keys`."""

    def _owner(self) -> HistoryTransform[Memory]:
        """The transform whose memories are those of the worlds that this one sees."""
        # TorchRL's MultiAction steps through copies of the transforms before it, in an environment of their
        # own around the same worlds.
        for original in self._cloned_from:
            here, there = find_container(self), find_container(original)
            if here is not there and _find_base(here) is _find_base(there) is not None:
                return original._owner()
        return self

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        owner, n = self._owner(), tensordict_reset.batch_size.numel()
        if len(owner._memories) != n:
            owner._memories = [self._begin() for _ in range(n)]
        rows = _marked_rows(tensordict, "_reset", n)
        for row in rows:
            owner._memories[row] = self._begin()
        return self._see(tensordict_reset, owner._memories, rows)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        memories = self._owner()._memories
        if len(memories) != next_tensordict.batch_size.numel():
            raise ConfigError(
                f"{type(self).__name__} has seen the reset of {len(memories)} worlds and a step of "
                f"{next_tensordict.batch_size.numel()}: reset the environment before its first step, and "
                "step all of its worlds together."
            )
        self._seen = {key: next_tensordict.get(key) for key in self.in_keys}
        return self._see(next_tensordict, memories, _marked_rows(tensordict, "_step", len(memories)))

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if readers := [each for each in _find_later(self) if _share_keys(self, each)]:
            raise ConfigError(
                f"{type(readers[0]).__name__} reads what {type(self).__name__} writes, in an environment "
                "that resets itself: TorchRL does not call it again for the first observation of an episode. "
                "Build the environment with native_autoreset=False."
            )
        # What the step has written is of the episode before: begin with what it was given.
        begun = self._reset(tensordict, tensordict_reset.copy().update(self._seen))
        return tensordict_reset.update(begun.select(*self.out_keys))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Transform a tensordict of trajectories [*, T], and its "next" where there is one."""
        if not tensordict.batch_dims:
            name = type(self).__name__
            raise ConfigError(f"{name} needs a time dimension, the last of the batch: give [*, T].")
        after = tensordict.get("next", None)
        horizon, n = tensordict.batch_size[-1], tensordict.batch_size[:-1].numel()
        begins = _find_beginnings(tensordict).reshape(n, horizon)
        memories, every = [self._begin() for _ in range(n)], list(range(n))
        steps, next_steps = [], []
        for t in range(horizon):
            now: Any = tensordict[..., t]
            fresh = begins[:, t].nonzero()[:, 0].tolist()
            for row in fresh:
                memories[row] = self._begin()
            steps.append(self._see(now.exclude("next"), memories, every if after is None else fresh))
            if after is not None:
                next_steps.append(self._see(after[..., t].copy(), memories, every))
        tensordict.update(self._written(steps))
        if after is not None:
            tensordict.set("next", after.update(self._written(next_steps)))
        return tensordict

    def _written(self, steps: list[TensorDictBase]) -> TensorDictBase:
        whole: Any = torch.stack([step.select(*self.out_keys) for step in steps], dim=-1)
        return whole


def _marked_rows(tensordict: TensorDictBase | None, key: str, n: int) -> list[int]:
    """Which of n batch elements a mask in the tensordict marks; all where there is none."""
    mask = None if tensordict is None else tensordict.get(key, None)
    return list(range(n)) if mask is None else mask.reshape(n, -1).any(-1).nonzero()[:, 0].tolist()


def _find_beginnings(trajectories: TensorDictBase) -> Tensor:
    """(*, T) bool: the steps of (*, T) that do not go on from the one before."""
    goes_on = find_same(trajectories)
    if trajectories.get(("next", "done"), None) is not None:
        goes_on = find_links(trajectories)[1][..., :-1]
    first = torch.ones(*trajectories.shape[:-1], 1, dtype=torch.bool, device=goes_on.device)
    return torch.cat((first, ~goes_on), dim=-1)


def _find_base(env: EnvBase | None) -> EnvBase | None:
    return env.base_env if isinstance(env, TransformedEnv) else env


def _find_later(transform: Transform) -> list[Transform]:
    """The transforms that an environment calls after `transform`."""
    env = find_container(transform)
    chain = _flatten(cast(Transform, env.transform)) if isinstance(env, TransformedEnv) else []
    places = [place for place, each in enumerate(chain) if each is transform]
    return chain[places[0] + 1 :] if places else []


def _flatten(transform: Transform) -> list[Transform]:
    if not isinstance(transform, Compose):
        return [transform]
    return [each for part in transform.transforms for each in _flatten(cast(Transform, part))]


def _share_keys(first: Transform, later: Transform) -> bool:
    return not set(first.out_keys).isdisjoint(later.in_keys or ())
