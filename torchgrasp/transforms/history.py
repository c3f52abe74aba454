"""Transforms that remember an episode: a memory for each world, begun anew at its reset."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Generic, Self, TypeVar

import torch
from tensordict import TensorDictBase

from torchgrasp.errors import ConfigError
from torchgrasp.transforms.base import PointTransform

Memory = TypeVar("Memory")


class HistoryTransform(PointTransform, Generic[Memory]):
    """A transform whose result depends on what the episode showed before.

    In an environment each world's memory begins anew at its reset. On a tensordict that is not an
    environment's, the last batch dimension is time, and a memory begins anew after each ("next", "done").

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

    def clone(self) -> Self:
        """A copy for another environment, which has seen nothing yet."""
        copied = super().clone()
        copied._memories = []
        return copied

    @abstractmethod
    def _begin(self) -> Memory:
        """The memory of an episode that has shown nothing yet."""

    @abstractmethod
    def _see(self, tensordict: TensorDictBase, memories: list[Memory], rows: list[int]) -> TensorDictBase:
        """Add the batch elements `rows` to their memories, and write every element's `out_keys`."""

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        n = tensordict_reset.batch_size.numel()
        if len(self._memories) != n:
            self._memories = [self._begin() for _ in range(n)]
        rows = _marked_rows(tensordict, "_reset", n)
        for row in rows:
            self._memories[row] = self._begin()
        return self._see(tensordict_reset, self._memories, rows)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        rows = _marked_rows(tensordict, "_step", len(self._memories))
        return self._see(next_tensordict, self._memories, rows)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Transform a tensordict of trajectories [*, T], and its "next" where there is one."""
        if not tensordict.batch_dims:
            name = type(self).__name__
            raise ConfigError(f"{name} needs a time dimension, the last of the batch: give [*, T].")
        after = tensordict.get("next", None)
        horizon, n = tensordict.batch_size[-1], tensordict.batch_size[:-1].numel()
        memories = [self._begin() for _ in range(n)]
        every, fresh = list(range(n)), list(range(n))
        steps, next_steps = [], []
        for t in range(horizon):
            now: Any = tensordict[..., t]
            for row in fresh if after is not None else ():
                memories[row] = self._begin()
            steps.append(self._see(now.exclude("next"), memories, every if after is None else fresh))
            if after is not None:
                next_steps.append(self._see(after[..., t].copy(), memories, every))
                done = after.get("done")[..., t, :].reshape(n, -1).any(-1)
                fresh = done.nonzero()[:, 0].tolist()
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
