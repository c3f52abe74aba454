"""What a run learns from: its demonstrations, and the episodes of its own that are added."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from torchgrasp.data import (
    CompactTransitions,
    MixtureReplayBuffer,
    Priority,
    estimate_bytes,
    open_demonstrations,
)
from torchgrasp.data.demonstration_kinds import COUNTED
from torchgrasp.data.demonstration_sources import DemonstrationSource, check_rows
from torchgrasp.data.demonstrations import Demonstrations
from torchgrasp.data.drawn_ahead import DrawnAhead
from torchgrasp.data.shares import share_batch
from torchgrasp.episodes import split_tries
from torchgrasp.errors import ConfigError

# What a summary tells of the card of demonstrations.
_TOLD = ("kind", "episodes", "successes", "steps", "successful_steps", "bytes")


class Experience:
    """A replay buffer with a source for the run's own episodes, and one for each folder of demonstrations.

    Args:
        own: name of the source that episodes are added to.
        capacity: transitions of that source; 0 where no episode is added.
        row: an encoded transition (1), as `CompactTransitions.example_row` gives it.
        codec: how transitions are stored.
        given_row: an encoded transition (1) as files of demonstrations hold it; `row` where that is the same.
        batch_size: of a batch.
        own_share: of a batch that is drawn from own episodes, in [0, 1].
        seed: of the draws.
        augment: a transform of sampled batches; its inverse of episodes as they are added.
        priority: None draws uniformly within a source.
        folder: keeps the transitions on disk there.
        device: that batches are moved to.
        ahead: batches of `batches` whose rows a thread draws ahead, in pinned memory where the device is a
            CUDA device, and which are decoded and augmented on the device. 0 draws each when it is asked for;
            so does a priority, which follows from the batch before, and an augmentation that has tensors of
            its own elsewhere. The draws are the same.
    """

    def __init__(
        self,
        own: str,
        *,
        capacity: int,
        row: TensorDictBase,
        codec: CompactTransitions,
        batch_size: int,
        own_share: float,
        seed: int,
        augment: Transform | None = None,
        priority: Priority | None = None,
        given_row: TensorDictBase | None = None,
        folder: str | None = None,
        device: torch.device | str = "cpu",
        ahead: int = 0,
    ) -> None:
        self._given_row = row if given_row is None else given_row
        self.own, self.codec, self.row, self.priority = own, codec, row, priority
        self._capacity, self._batch_size, self._own_share = capacity, batch_size, own_share
        self._seed, self._augment, self._folder = seed, augment, folder
        at_once = priority is not None or (augment is not None and any(True for _ in augment.buffers()))
        self._device, self._ahead = torch.device(device), 0 if at_once else ahead
        self._drawing: DrawnAhead[TensorDictBase] | None = None
        self.buffer: MixtureReplayBuffer
        self._sources: list[DemonstrationSource] = []
        self._opened: dict[str, Demonstrations] = {}

    def make_buffer(self, sources: Sequence[DemonstrationSource]) -> None:
        """An empty buffer with room for the demonstrations of the sources, which must fit `row`."""
        self._sources, self._opened = list(sources), {}
        for source in sources:
            self._opened[source.name] = open_demonstrations(source.path)
            check_rows(self._opened[source.name], self._given_row)
        rows = {name: opened.card["rows"] for name, opened in self._opened.items()}
        capacities = {self.own: max(1, self._capacity), **rows}
        size = estimate_bytes(sum(capacities.values()), self.row, prioritised=self.priority is not None)
        print(f"Replay buffer: up to {size / 1e9:.2f} GB for {capacities} transitions")
        self.buffer = MixtureReplayBuffer(
            capacities,
            share_batch(self.own, self._own_share, self._weigh()),
            batch_size=self._batch_size,
            seed=self._seed,
            folder=self._folder,
            row=self.row,
            priority=self.priority,
            codec=self.codec,
            transform=self._augment,
        )

    def _weigh(self, *, labelled: bool = False) -> dict[str, float]:
        """Weight of each source of demonstrations, 0 without labels where those are wanted."""
        weights = {}
        for each in self._sources:
            steps = self._opened[each.name].card[COUNTED[each.count]]
            weight = steps if each.weight is None else each.weight
            weights[each.name] = float(weight) if each.labels or not labelled else 0.0
        if weights and not sum(weights.values()):
            raise ConfigError(
                "No demonstrations are left to learn from: give one of them labels=true and a weight above 0."
            )
        return weights

    def load_demonstrations(self) -> None:
        """Fill each source with the steps of its demonstrations that count."""
        for source in self._sources:
            for rows in self._opened[source.name].iterate_rows():
                self.buffer.extend_rows(source.choose(rows), source=source.name)

    def add(self, steps: TensorDictBase) -> None:
        """Add an episode's steps (T) to the run's own, and the actions that were tried at its end."""
        self._pause()
        self.buffer.extend(steps[None], source=self.own)
        self.buffer.extend(split_tries(steps), source=self.own)

    def draw_demonstrations(self) -> None:
        """From the next batch on, draw from demonstrations with labels alone."""
        self._set_shares(0.0, labelled=True)

    def draw_all(self, *, labelled: bool = False) -> None:
        """From the next batch on, draw from own episodes too; on demand from labelled sources alone."""
        self._set_shares(self._own_share if self._capacity else 0.0, labelled=labelled)

    def _set_shares(self, own_share: float, *, labelled: bool) -> None:
        self._pause()
        self.buffer.set_shares(share_batch(self.own, own_share, self._weigh(labelled=labelled)))

    def sample(self, batch_size: int | None = None) -> TensorDictBase:
        """A batch (B) on the device; as many as the buffer's own batches have by default."""
        self._pause()
        return self.buffer.sample(batch_size).to(self._device)

    def batches(self, count: int, batch_size: int | None = None) -> Generator[TensorDictBase, None, None]:
        """`count` batches (B) on the device, the same as of so many calls of `sample`; to be closed.

        Transforms of sampled batches are applied where a batch is handed out, in this thread.
        """
        if not self._ahead:
            for _ in range(count):
                yield self.sample(batch_size)
            return
        self._pause()
        self._drawing = DrawnAhead(
            lambda: self._draw_rows(batch_size), self.buffer.generator, count=count, depth=self._ahead
        )
        try:
            for rows in self._drawing:
                yield self.buffer.decode_rows(_move(rows, self._device))
        finally:
            self._pause()
            self._drawing = None

    def _draw_rows(self, batch_size: int | None) -> TensorDictBase:
        rows = self.buffer.draw_rows(batch_size)
        if self._device.type != "cuda":
            return rows
        with torch.cuda.device(self._device):
            return cast(TensorDictBase, rows.apply(Tensor.pin_memory))

    def _pause(self) -> None:
        """Before anything that changes or saves what is drawn."""
        if self._drawing is not None:
            self._drawing.pause()

    def state_dict(self) -> dict[str, Any]:
        """The buffer's, as if no batch had been drawn ahead."""
        self._pause()
        return self.buffer.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take up what `state_dict` gave, before any batch is drawn."""
        self.buffer.load_state_dict(state)

    def update_priorities(self, batch: TensorDictBase) -> None:
        """Draw a batch (B) by its `td_error` from now on, where there is a priority."""
        self.buffer.update_tensordict_priority(batch)

    def anneal(self, progress: float) -> None:
        """Raise beta to 1 over a run (Schaul et al. 2016, Sec. 3.4); `progress` in [0, 1]."""
        if self.priority is not None:
            self.buffer.beta = self.priority.beta + progress * (1.0 - self.priority.beta)

    def describe(self) -> dict:
        """Kind, episodes, successes, steps and bytes of the demonstrations, and of further ones by name."""
        cards = {name: {key: each.card[key] for key in _TOLD} for name, each in self._opened.items()}
        if not cards:
            return {}
        first, *others = cards
        more = {"more_demonstrations": {name: cards[name] for name in others}} if others else {}
        return {"demonstrations": cards[first], **more}


def _move(rows: TensorDictBase, device: torch.device) -> TensorDictBase:
    """Rows (B) on the device, without waiting for it."""
    return cast(TensorDictBase, rows.apply(lambda each: each.to(device, non_blocking=True), device=device))
