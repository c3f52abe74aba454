"""MixtureWriter: sends rows to the ring of their source."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data.replay_buffers.storages import Storage
from torchrl.data.replay_buffers.writers import Writer

from torchgrasp import keys
from torchgrasp.data.state_files import StateFiles
from torchgrasp.data.storage import MixtureStorage
from torchgrasp.errors import ConfigError


class MixtureWriter(StateFiles, Writer):
    """Writes rows into a MixtureStorage, each source round its own ring, oldest rows first to go.

    Args:
        source_key: int64 (*, 1) or (*): a row's source, counted in the order of the storage's capacities.
    """

    _storage: Any

    def __init__(self, *, source_key: NestedKey = keys.SOURCE) -> None:
        super().__init__()
        self._source_key = source_key
        # Where each ring goes on, and how many rows were written: in memory that lies open to other
        # processes, which may write as well.
        self._counts = torch.zeros(0, dtype=torch.int64)

    def register_storage(self, storage: Storage) -> None:
        """Adopt `storage`, which must be a MixtureStorage."""
        if not isinstance(storage, MixtureStorage):
            kind = type(storage).__name__
            raise ConfigError(f"MixtureWriter was given a {kind}: build the buffer with a MixtureStorage.")
        super().register_storage(storage)
        if not self._counts.numel():
            self._counts = torch.zeros(len(storage.capacities) + 1, dtype=torch.int64).share_memory_()

    @property
    def _write_count(self) -> int:
        return int(self._counts[-1])

    def add(self, data: TensorDictBase) -> int:
        """Write one row; returns its flat index."""
        return int(self.extend(data.unsqueeze(0)))

    def extend(self, data: TensorDictBase) -> Tensor:
        """Write rows (k) in their order; returns their flat indices (k).

        Of a source with more rows than its capacity only the last are kept; the earlier ones are
        given the index of the row that took their place.
        """
        source = data.get(self._source_key).reshape(-1).cpu()
        index = torch.empty_like(source)
        for number in source.unique().tolist():
            mine = (source == number).nonzero().squeeze(-1)
            name, index[mine] = self._advance(number, mine.numel())
            kept = mine[-self._storage.capacities[name] :]
            self._storage.set(index[kept], data if kept.numel() == len(data) else data[kept])
            for entity in self._storage._attached_entities:
                entity.mark_update(index[kept])
        self._counts[-1] += source.numel()
        return index

    def _advance(self, number: int, num_rows: int) -> tuple[str, Tensor]:
        names = list(self._storage.capacities)
        if not 0 <= number < len(names):
            known = dict(enumerate(names))
            raise ConfigError(f"{self._source_key}={number} is no source: the storage has {known}.")
        name = names[number]
        capacity, cursor = self._storage.capacities[name], int(self._counts[number])
        self._counts[number] = (cursor + num_rows) % capacity
        rows = (cursor + torch.arange(num_rows)) % capacity
        return name, self._storage.offsets[name] + rows

    def _empty(self, empty_write_count: bool = True) -> None:
        self._counts[:-1] = 0
        if empty_write_count:
            self._counts[-1] = 0

    def state_dict(self) -> dict[str, Any]:
        """Where each ring goes on."""
        cursors = dict(zip(self._storage.capacities, self._counts[:-1].tolist(), strict=True))
        return {"cursors": cursors, "write_count": self._write_count}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Undo `state_dict`."""
        cursors = [state_dict["cursors"][name] for name in self._storage.capacities]
        self._counts.copy_(torch.tensor([*cursors, state_dict["write_count"]]))
