"""MixtureSampler: batches that mix sources in exact shares (Sec. 6.4: 70 % online, 30 % expert)."""

from __future__ import annotations

from collections.abc import Mapping
from multiprocessing.context import get_spawning_popen
from typing import Any, cast

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage

from torchgrasp import keys
from torchgrasp.data.index_pool import IndexPool
from torchgrasp.data.priorities import Priority, PriorityPool
from torchgrasp.data.shares import check_shares, split_batch
from torchgrasp.data.state_files import StateFiles
from torchgrasp.data.storage_rows import find_filled_rows, flatten_index, read_columns, unflatten_index
from torchgrasp.data.write_journal import WriteJournal
from torchgrasp.errors import ConfigError, check_range

STUB = "stub"


class MixtureSampler(StateFiles, Sampler):
    """Draws every batch with an exact number of rows from each source, within a source by chance.

    Works in any TorchRL replay buffer whose rows say where they come from: an int64 `source_key`
    of shape (*, 1) or (*) that counts the names of `shares` in their order. Numbers of rows are
    `split_batch`'s (largest remainders). A source without data gives its rows to the others in
    proportion to their shares. Rows of one source stand together in the batch, in the order of
    `shares`. Rows flagged in `skip_key` (where the storage has it) are never drawn.

    Rows count from the next batch on, whoever wrote them: this process, others that the buffer is shared
    with, such as those of a MultiSyncCollector, or another buffer of the same storage.

    Draws are uniform, at a cost that does not grow with the storage, or, given a `priority`, in
    proportion to (|δ| + eps)^alpha among the rows of a source, at a cost that grows with the
    logarithm. New rows then count as much as the largest error of their source so far. The batch
    gets ``priority_weight`` (B), (N P(i))^-beta by the largest in the batch, N and P those of the
    row's source: rows of one source are corrected towards a uniform draw, and shares stay what they
    are. ``buffer.update_priority(batch["index"], batch["td_error"])`` takes up the errors that a loss
    wrote. So does ``update_tensordict_priority(batch)`` of a `MixtureReplayBuffer`; that of other buffers
    does nothing here, since TorchRL's knows no sampler with priorities but its own PrioritizedSampler.

    Args:
        shares: source name -> share; shares add up to 1.
        priority: prefers rows of large errors (Schaul et al. 2016); uniform if None.
        source_key: where a row's source number stands.
        skip_key: where a row says that it is no transition.
        spans: source name -> the row numbers that its rows have, such as `MixtureStorage.spans`: what is
            kept for a row takes no more memory than those need. Any numbers if None.

    >>> from tensordict import TensorDict
    >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    >>> buffer = TensorDictReplayBuffer(
    ...     storage=LazyTensorStorage(1000),
    ...     sampler=MixtureSampler({"online": 0.7, "expert": 0.3}, priority=Priority()),
    ...     batch_size=250,
    ... )
    >>> source = (torch.arange(1000) % 10 == 0).long()
    >>> _ = buffer.extend(TensorDict({"x": torch.randn(1000, 3), "source": source}, [1000]))
    >>> batch = buffer.sample()
    >>> buffer.update_priority(batch["index"], torch.rand(250))
    >>> int(batch["source"].sum()), batch["priority_weight"].unique()
    (75, tensor([1.]))
    """

    def __init__(
        self,
        shares: Mapping[str, float],
        *,
        priority: Priority | None = None,
        source_key: NestedKey = keys.SOURCE,
        skip_key: NestedKey = STUB,
        spans: Mapping[str, range] | None = None,
    ) -> None:
        super().__init__()
        self._shares = check_shares(shares)
        self._priority = priority
        self._beta = 0.0 if priority is None else priority.beta
        self._source_key = source_key
        self._skip_key = skip_key
        if spans is not None and set(spans) != set(self._shares):
            raise ConfigError(f"spans of {list(spans)} were given for the sources {list(self._shares)}.")
        self._spans = dict.fromkeys(self._shares) if spans is None else dict(spans)
        self._journal = WriteJournal()
        self._follows = True
        self._empty()

    @property
    def beta(self) -> float:
        """Exponent of the weights; set it to anneal it, or give it to TorchRL's LinearScheduler."""
        return self._beta

    @beta.setter
    def beta(self, beta: float) -> None:
        check_range("beta", float(beta), 0.0, 1.0)
        self._beta = float(beta)

    @property
    def shares(self) -> dict[str, float]:
        """The share of each source now."""
        return dict(self._shares)

    def set_shares(self, shares: Mapping[str, float]) -> None:
        """Use `shares` from the next batch on; the names must be those of construction."""
        values = check_shares(shares)
        if values.keys() != self._shares.keys():
            raise ConfigError(f"shares of {list(values)} were given for the sources {list(self._shares)}.")
        self._shares = {name: values[name] for name in self._shares}

    def num_rows(self) -> dict[str, int]:
        """How many rows of each source can be drawn."""
        self._catch_up(self._storage)
        return {name: len(pool) for name, pool in self._pools.items()}

    def sample(self, storage: Storage, batch_size: int) -> tuple[Any, dict]:
        """(batch_size) int64 row numbers, grouped by source; with a priority, their weights too.

        Of a storage with ``ndim`` above 1, a tuple of indices.
        """
        self._follows = True
        self._catch_up(storage)
        filled = {name: share for name, share in self._shares.items() if share > 0 and len(self._pools[name])}
        if not filled:
            raise RuntimeError(
                f"There is nothing to sample: rows per source {self.num_rows()}, shares {self._shares}. "
                "Extend the buffer first, with data of a source whose share is above 0."
            )
        counts = split_batch(batch_size, filled)
        rows = {name: self._pools[name].draw(count, self._rng) for name, count in counts.items() if count}
        return unflatten_index(storage, torch.cat([*rows.values()])), self._weigh(rows)

    def _weigh(self, rows: Mapping[str, Tensor]) -> dict[str, Tensor]:
        if self._priority is None:
            return {}
        parts = [cast(PriorityPool, self._pools[name]).relative(each) for name, each in rows.items()]
        weights = torch.cat(parts) ** -self._beta
        return {"priority_weight": (weights / weights.max()).float()}

    def update_priority(
        self, index: int | Tensor, priority: float | Tensor, *, storage: Storage | None = None
    ) -> None:
        """Take up the errors `priority` (k or one) of the rows at `index` (k); nothing without a priority."""
        if self._priority is None:
            return
        rows = torch.as_tensor(index).reshape(-1).cpu() if storage is None else flatten_index(storage, index)
        weights = self._priority.weigh(torch.as_tensor(priority).reshape(-1)).expand(rows.shape)
        for pool in self._pools.values():
            cast(PriorityPool, pool).set_weights(rows, weights)

    def mark_update(self, index: int | Tensor, *, storage: Storage | None = None) -> None:
        """Note that the rows at `index` were written; TorchRL's writers call this, in whatever process."""
        if storage is None:
            return
        self._journal.post(flatten_index(storage, index).unique())
        if self._follows:
            self._catch_up(storage)

    def _catch_up(self, storage: Storage | None) -> None:
        """Sort in the rows that were written since the last time."""
        if storage is None:
            return
        rows = self._journal.read()
        # Each write is one revision and one post, unless others than this sampler's buffer wrote.
        unposted = int(storage._mutation_revision) - self._journal.num_posts
        known = storage is self._storage and unposted == self._unposted
        self._storage, self._unposted = storage, unposted
        if rows is None or not known:
            self._sort_anew(storage)
        elif rows.numel():
            for pool, mine, others in self._split(storage, rows):
                pool.remove(others)
                pool.add(mine)

    def _sort_anew(self, storage: Storage) -> None:
        """Make the pools what the whole storage says; rows whose source is as before keep their weights."""
        rows = find_filled_rows(storage)
        if not rows.numel():
            for pool in self._pools.values():
                pool.remove(pool.members.clone())
            return
        for pool, mine, _ in self._split(storage, rows):
            pool.remove(pool.members[~torch.isin(pool.members, mine)])
            pool.add(mine[~pool.contains(mine)])

    def _split(self, storage: Storage, rows: Tensor) -> list[tuple[IndexPool, Tensor, Tensor]]:
        """For each source its pool, those of the `rows` (k) that it may draw, and the others."""
        source, skip = self._read_labels(storage, rows)
        masks = [(source == number) & ~skip for number in range(len(self._pools))]
        return [
            (pool, rows[mask], rows[~mask]) for pool, mask in zip(self._pools.values(), masks, strict=True)
        ]

    def _read_labels(self, storage: Storage, rows: Tensor) -> tuple[Tensor, Tensor]:
        labels = read_columns(storage, rows, (self._source_key, self._skip_key))
        source = labels.get(self._source_key, None)
        if source is None:
            raise ConfigError(f"Rows were written without {self._source_key!r}: add an int64 source number.")
        if source.numel() != rows.numel():
            raise ConfigError(
                f"Rows have {self._source_key!r} of shape {tuple(source.shape[1:])}, one number is expected: "
                "extend the buffer with data.reshape(-1), or give its storage the data's ndim."
            )
        source = source.reshape(-1).cpu()
        if not 0 <= int(source.min()) <= int(source.max()) < len(self._pools):
            names = dict(enumerate(self._pools))
            raise ConfigError(f"Source numbers {source.unique().tolist()} were written, expected {names}.")
        skip = labels.get(self._skip_key, None)
        return source, torch.zeros_like(source, dtype=torch.bool) if skip is None else skip.reshape(-1).cpu()

    def _sampleable_count(self, storage: Storage, batch_size: int) -> int:
        self._catch_up(storage)
        return sum(len(pool) for name, pool in self._pools.items() if self._shares[name] > 0)

    def _empty(self) -> None:
        self._storage: Storage | None = None
        self._unposted: int | None = None
        self._pools = self._make_pools()

    def _make_pools(self) -> dict[str, IndexPool]:
        make = IndexPool if self._priority is None else PriorityPool
        return {name: make(self._spans[name]) for name in self._shares}

    def state_dict(self) -> dict[str, Any]:
        """Shares, and the drawable rows of each source in their order, so that draws repeat.

        With a priority also the weights of the rows, the largest so far, and beta.
        """
        self._catch_up(self._storage)
        rows = {name: pool.members.clone() for name, pool in self._pools.items()}
        state: dict[str, Any] = {"shares": self.shares, "rows": rows}
        pools = {name: pool for name, pool in self._pools.items() if isinstance(pool, PriorityPool)}
        if pools:
            state["weights"] = {name: pool.weights for name, pool in pools.items()}
            state["largest"] = {name: pool.largest for name, pool in pools.items()}
            state["beta"] = self._beta
        return state

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Undo `state_dict`; the sources must be the same, and both with a priority or both without."""
        if ("weights" in state_dict) != (self._priority is not None):
            raise ConfigError(
                f"A sampler {'with' if 'weights' in state_dict else 'without'} a priority was saved and "
                f"cannot be loaded with priority={self._priority}: build it as it was."
            )
        self.set_shares(state_dict["shares"])
        # What was written until now is not of this state: it is read from the storage that comes with it.
        self._journal.read()
        self._storage = None
        for name, pool in self._pools.items():
            if not isinstance(pool, PriorityPool):
                pool.load(state_dict["rows"][name])
                continue
            pool.load(state_dict["rows"][name], state_dict["weights"][name])
            pool.largest = state_dict["largest"][name]
            self._beta = state_dict["beta"]

    def __getstate__(self) -> dict[str, Any]:
        state = {**super().__getstate__(), "_storage": None}
        if get_spawning_popen() is None:
            return state
        # A process that writes needs no pools, and would get them in memory that is shared with ours.
        del state["_pools"]
        return {**state, "_follows": False}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._pools = state.get("_pools") or self._make_pools()

    def __repr__(self) -> str:
        return f"MixtureSampler(shares={self._shares}, rows={self.num_rows()})"
