"""MixtureSampler: batches that mix sources of data in exact shares (Sec. 6.4: 70 % online, 30 % expert)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import torch
from safetensors.torch import load_file, save_file
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage

from torchgrasp.data.index_pool import IndexPool
from torchgrasp.data.shares import check_shares, split_batch
from torchgrasp.errors import ConfigError

SOURCE = "source"
STUB = "stub"


class MixtureSampler(Sampler):
    """Draws every batch with an exact number of rows from each source, uniformly within a source.

    Works in any TorchRL replay buffer whose rows say where they come from: an int64 `source_key`
    of shape (*, 1) or (*) that counts the names of `shares` in their order. Numbers of rows are
    `split_batch`'s (largest remainders). A source without data gives its rows to the others in
    proportion to their shares. Rows of one source stand together in the batch, in the order of
    `shares`. Rows flagged in `skip_key` (where the storage has it) are never drawn. The cost does
    not grow with the storage. Fill the buffer from the process that samples it.

    Args:
        shares: source name -> share; shares add up to 1.
        source_key: where a row's source number stands.
        skip_key: where a row says that it is no transition.

    >>> from tensordict import TensorDict
    >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    >>> buffer = TensorDictReplayBuffer(
    ...     storage=LazyTensorStorage(1000),
    ...     sampler=MixtureSampler({"online": 0.7, "expert": 0.3}),
    ...     batch_size=250,
    ... )
    >>> source = (torch.arange(1000) % 10 == 0).long()
    >>> _ = buffer.extend(TensorDict({"x": torch.randn(1000, 3), "source": source}, [1000]))
    >>> int(buffer.sample()["source"].sum())
    75
    """

    def __init__(
        self,
        shares: Mapping[str, float],
        *,
        source_key: NestedKey = SOURCE,
        skip_key: NestedKey = STUB,
    ) -> None:
        super().__init__()
        self._shares = check_shares(shares)
        self._pools = {name: IndexPool() for name in self._shares}
        self._source_key = source_key
        self._skip_key = skip_key

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
        return {name: len(pool) for name, pool in self._pools.items()}

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict]:
        """(batch_size) int64 row numbers, grouped by source, and an empty info."""
        filled = {name: share for name, share in self._shares.items() if share > 0 and len(self._pools[name])}
        if not filled:
            raise RuntimeError(
                f"There is nothing to sample: rows per source {self.num_rows()}, shares {self._shares}. "
                "Extend the buffer first, with data of a source whose share is above 0."
            )
        counts = split_batch(batch_size, filled)
        return torch.cat([self._pools[name].draw(n, self._rng) for name, n in counts.items()]), {}

    def mark_update(self, index: int | Tensor, *, storage: Storage | None = None) -> None:
        """Note that the rows at `index` were written; TorchRL's writers call this."""
        if storage is None:
            return
        rows = torch.as_tensor(index).reshape(-1).unique().cpu()
        source, skip = self._read_labels(storage, rows)
        for number, pool in enumerate(self._pools.values()):
            belongs = (source == number) & ~skip
            pool.remove(rows[~belongs])
            pool.add(rows[belongs])

    def _read_labels(self, storage: Storage, rows: Tensor) -> tuple[Tensor, Tensor]:
        labels = _read(storage, rows, (self._source_key, self._skip_key))
        source = labels.get(self._source_key, None)
        if source is None:
            raise ConfigError(f"Rows were written without {self._source_key!r}: add an int64 source number.")
        source = source.reshape(-1).cpu()
        if not 0 <= int(source.min()) <= int(source.max()) < len(self._pools):
            names = dict(enumerate(self._pools))
            raise ConfigError(f"Source numbers {source.unique().tolist()} were written, expected {names}.")
        skip = labels.get(self._skip_key, None)
        return source, torch.zeros_like(source, dtype=torch.bool) if skip is None else skip.reshape(-1).cpu()

    def _sampleable_count(self, storage: Storage, batch_size: int) -> int:
        return sum(len(pool) for name, pool in self._pools.items() if self._shares[name] > 0)

    def _empty(self) -> None:
        self._pools = {name: IndexPool() for name in self._shares}

    def state_dict(self) -> dict[str, Any]:
        """Shares, and the drawable rows of each source in their order, so that draws repeat."""
        rows = {name: pool.members.clone() for name, pool in self._pools.items()}
        return {"shares": self.shares, "rows": rows}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Undo `state_dict`; the sources must be the same."""
        self.set_shares(state_dict["shares"])
        for name, pool in self._pools.items():
            pool.load(state_dict["rows"][name])

    def dumps(self, path: str | Path) -> None:
        """Write `state_dict` into the folder `path`."""
        folder = Path(path)
        folder.mkdir(parents=True, exist_ok=True)
        state = self.state_dict()
        (folder / "shares.json").write_text(json.dumps(state["shares"]))
        save_file(state["rows"], folder / "rows.safetensors")

    def loads(self, path: str | Path) -> None:
        """Read what `dumps` wrote."""
        shares = json.loads((Path(path) / "shares.json").read_text())
        self.load_state_dict({"shares": shares, "rows": load_file(Path(path) / "rows.safetensors")})

    def __repr__(self) -> str:
        return f"MixtureSampler(shares={self._shares}, rows={self.num_rows()})"


def _read(storage: Storage, rows: Tensor, keys: tuple[NestedKey, ...]) -> TensorDictBase:
    # MixtureStorage reads single columns; other storages hand out whole rows.
    read_columns = getattr(storage, "read_columns", None)
    return cast(Any, storage).get(rows) if read_columns is None else read_columns(rows, keys)
