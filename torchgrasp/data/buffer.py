"""MixtureReplayBuffer: the replay buffer of Sec. 6.4, whole."""

from __future__ import annotations

from collections.abc import Mapping
from multiprocessing.context import get_spawning_popen
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer
from torchrl.envs.transforms import Compose, Transform

from torchgrasp import keys
from torchgrasp.data.buffer_memory import check_space, count_row_bytes
from torchgrasp.data.compact import CompactTransitions
from torchgrasp.data.priorities import Priority
from torchgrasp.data.sampler import MixtureSampler
from torchgrasp.data.shares import check_shares
from torchgrasp.data.state_files import StateFiles
from torchgrasp.data.storage import SUCCESSOR, MixtureStorage, keep_batch
from torchgrasp.data.writer import MixtureWriter
from torchgrasp.errors import ConfigError


class MixtureReplayBuffer(StateFiles, TensorDictReplayBuffer):
    """A TensorDictReplayBuffer of compact transitions from several sources, mixed in exact shares.

    `extend` takes tensordicts (*, T) as collectors and rollouts give them; `sample` gives (B).

    Args:
        capacities: source name -> rows (steps, and one more for each cut of a trajectory).
        shares: source name -> share of every batch; the same names, adding up to 1.
        batch_size: rows of a batch.
        seed: of the draws.
        folder: keeps the rows on disk below it; in memory if None.
        row: encoded rows (R) like those to come, of a demonstration file or the codec's `example_row`:
            checks at once that a full buffer of such fits; otherwise the first `extend` checks.
        priority: prefers rows of large errors within a source; uniform if None.
        codec: how transitions are stored; CompactTransitions() if None.
        transform: applied to sampled transitions, after decoding; its inverse to what `extend` is
            given, before encoding.
        prefetch: batches that a background thread draws ahead.

    >>> from tensordict import TensorDict
    >>> buffer = MixtureReplayBuffer(
    ...     {"online": 64, "expert": 64},
    ...     {"online": 0.7, "expert": 0.3},
    ...     batch_size=10,
    ...     codec=CompactTransitions(gripper_points=False),
    ... )
    >>> outcome = {key: torch.zeros(2, 5, 1, dtype=torch.bool) for key in ("done", "terminated")}
    >>> state = {"points": torch.randn(2, 5, 32, 3), "time_left": torch.rand(2, 5, 1)}
    >>> following = {**state, **outcome, "reward": torch.zeros(2, 5, 1)}
    >>> rollout = TensorDict({**state, "action": torch.randn(2, 5, 6), "next": following}, [2, 5])
    >>> _ = buffer.extend(rollout, source="online")
    >>> _ = buffer.extend(rollout, source="expert")
    >>> batch = buffer.sample()
    >>> batch["next", "points"].shape, batch["source"].sum()
    (torch.Size([10, 32, 3]), tensor(3))
    """

    def __init__(
        self,
        capacities: Mapping[str, int],
        shares: Mapping[str, float],
        *,
        batch_size: int,
        seed: int = 0,
        folder: str | Path | None = None,
        row: TensorDictBase | None = None,
        priority: Priority | None = None,
        codec: CompactTransitions | None = None,
        transform: Transform | None = None,
        prefetch: int | None = None,
    ) -> None:
        _check_sources(capacities, check_shares(shares))
        self._prioritised = priority is not None
        if row is not None:
            row_bytes = count_row_bytes(row, prioritised=self._prioritised)
            check_space(sum(capacities.values()), row_bytes, folder=folder)
        codec = self._codec = codec or CompactTransitions()
        storage = MixtureStorage(capacities, folder=folder, next_keys=codec.observation_keys)
        ordered = {name: shares[name] for name in capacities}
        super().__init__(
            storage=storage,
            sampler=MixtureSampler(ordered, priority=priority, spans=storage.spans),
            writer=MixtureWriter(),
            collate_fn=keep_batch,
            transform=Compose(*(t for t in (codec, transform) if t is not None)),  # pyright: ignore
            batch_size=batch_size,
            prefetch=prefetch,
            generator=torch.Generator().manual_seed(seed),
        )
        self.sources = tuple(capacities)

    def extend(
        self,
        tensordicts: TensorDictBase,
        *,
        source: str | None = None,
        update_priority: bool | None = None,
    ) -> Tensor:
        """Add trajectories (*, T) to `source` (the one they name, else the first); returns row indices.

        Trajectories without a step add nothing. Their rows get the priority of new rows: errors
        handed in with them are not taken up.
        """
        if isinstance(tensordicts, TensorDictBase) and 0 in tensordicts.shape:
            return torch.zeros(0, dtype=torch.int64)
        return super().extend(self._tag(tensordicts, source), update_priority=update_priority)

    def add(self, data: TensorDictBase) -> int:
        """Refused: a step alone has no successor from which its next state could be read."""
        raise ConfigError(
            f"add was given data of batch size {tuple(data.shape)}: give trajectories (*, T), time last, to "
            "extend; one step alone as `step.unsqueeze(-1)`."
        )

    def extend_rows(self, rows: TensorDictBase, *, source: str) -> Tensor:
        """Add `rows` (R) that the codec has encoded, such as a demonstration file's.

        Features that it keeps are made of rows which lack them.
        """
        return self._extend(self._tag(self._codec.complete(rows), source))

    @property
    def generator(self) -> torch.Generator:
        """Of the draws; another one after a state was loaded."""
        return cast(torch.Generator, self._rng)

    def draw_rows(self, batch_size: int | None = None) -> TensorDictBase:
        """Encoded rows (B), of which `decode_rows` makes the batch that `sample` would have given.

        They are small, and may be decoded later and on another device.
        """
        size = cast(int, self._batch_size if batch_size is None else batch_size)
        with self._replay_lock, self._write_lock:
            index, info = self._sampler.sample(self._storage, size)
            rows = cast(MixtureStorage, self._storage).get(index)
        return rows.update({"index": index, **info})

    def decode_rows(self, rows: TensorDictBase) -> TensorDictBase:
        """Rows (B) of `draw_rows`, on any device, as a batch (B) there: decoded, and transformed."""
        return self._transform(rows)

    def update_tensordict_priority(self, data: TensorDictBase) -> None:
        """Take up the errors (B) or (B, *), the largest of each row, that a loss wrote into a sampled batch.

        Nothing without a priority.
        """
        # TorchRL's own passes over every sampler but its PrioritizedSampler.
        if not self._prioritised:
            return
        errors = data.get(self.priority_key, None)
        if errors is None:
            raise ConfigError(
                f"The batch has no {self.priority_key!r}: let the loss write each row's error there before "
                "it is handed to update_tensordict_priority."
            )
        index = data["index"].reshape(-1)
        self.update_priority(index, errors.reshape(index.numel(), -1).amax(-1))

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        if get_spawning_popen() is not None:
            # A process that writes draws nothing, and the generator's state that TorchRL makes here would be
            # gone before that process could read it.
            state["_rng"] = None
        return state

    def _tag(self, data: TensorDictBase, source: str | None) -> TensorDictBase:
        if source is None:
            return data
        if source not in self.sources:
            raise ConfigError(f"source={source!r} is none of the buffer's {self.sources}.")
        number = torch.tensor(self.sources.index(source), device=data.device)
        return data.copy().set(keys.SOURCE, number.expand(*data.shape, 1))

    @property
    def _mixture(self) -> MixtureSampler:
        return cast(MixtureSampler, self._sampler)

    @property
    def shares(self) -> dict[str, float]:
        """The share of each source now."""
        return self._mixture.shares

    def set_shares(self, shares: Mapping[str, float]) -> None:
        """Use `shares` from the next batch on (see `anneal_shares`)."""
        self._mixture.set_shares(shares)

    @property
    def beta(self) -> float:
        """Exponent of the weights of prioritised draws; set it to anneal it (see `MixtureSampler`)."""
        return self._mixture.beta

    @beta.setter
    def beta(self, beta: float) -> None:
        self._mixture.beta = beta

    def num_rows(self) -> dict[str, int]:
        """Transitions that can be drawn, by source."""
        return self._mixture.num_rows()

    def num_bytes(self) -> int:
        """Bytes that the rows take which are stored now, sampler included.

        `estimate_bytes` tells beforehand what a full buffer takes.
        """
        storage = cast(MixtureStorage, self._storage)
        filled = [storage.offsets[name] for name, count in storage.num_rows().items() if count]
        if not filled:
            return 0
        first = storage.read_columns(torch.tensor(filled[:1]), None).exclude(SUCCESSOR)
        return len(storage) * count_row_bytes(first, prioritised=self._prioritised)


def _check_sources(capacities: Mapping[str, int], shares: Mapping[str, float]) -> None:
    if set(capacities) != set(shares):
        raise ConfigError(
            f"capacities name {sorted(capacities)} and shares {sorted(shares)}: give both for each source."
        )
