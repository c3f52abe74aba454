"""ShardStorage: shards on disk as one TorchRL storage of transitions, read where they lie."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data.replay_buffers.storages import Storage

from torchgrasp.data.demonstration_kinds import find_counted
from torchgrasp.data.sampler import STUB
from torchgrasp.data.state_files import StateFiles
from torchgrasp.errors import ConfigError


class ShardStorage(StateFiles, Storage):
    """A read-only TorchRL storage over memory-mapped shards of encoded rows; nothing is copied.

    Its indices count transitions: rows that hold a last observation (stubs) have none, so that any
    of TorchRL's samplers can draw from it. `get` adds ("next", key) from the following row; on rows
    that terminated, from the row itself, as MixtureStorage does. A buffer over it needs
    ``collate_fn=keep_batch``; `Demonstrations.buffer` makes one.

    Args:
        shards: rows (R_k) of each shard, as `Demonstrations.shards` holds them, none empty.
        next_keys: observation keys whose next values are read from the following row.
        count: which episodes have indices: all, successful or failed.
    """

    def __init__(
        self, shards: Sequence[TensorDictBase], *, next_keys: Sequence[NestedKey] = (), count: str = "all"
    ) -> None:
        self._shards = tuple(shards)
        wanted = [find_counted(rows, count) & ~rows[STUB].squeeze(-1) for rows in self._shards]
        chosen = torch.cat(wanted) if wanted else torch.zeros(0, dtype=torch.bool)
        self._rows = chosen.nonzero().squeeze(-1)
        if not self._rows.numel():
            raise ConfigError(f"There are no transitions of {count} episodes: give another count.")
        super().__init__(self._rows.numel())
        ends = [(rows["terminated"] | rows[STUB]).squeeze(-1) for rows in self._shards]
        self._following = self._rows + (~torch.cat(ends)[self._rows]).long()
        self._bounds = torch.tensor([len(rows) for rows in self._shards]).cumsum(0)
        self._next_keys, self._names = tuple(next_keys), list(self._shards[0].keys(True, True))
        self._columns: dict[NestedKey, list[Tensor]] = {}

    def __len__(self) -> int:
        return self._rows.numel()

    def get(self, index: Any) -> TensorDictBase:
        """Transitions at `index` (int, slice, or integers of any shape), with ("next", key)."""
        rows = self._rows[index]
        batch = self._read(rows.reshape(-1), None)
        if self._next_keys:
            batch["next"] = self._read(self._following[index].reshape(-1), self._next_keys)
        return batch.reshape(rows.shape)

    def _read(self, rows: Tensor, names: Sequence[NestedKey] | None) -> TensorDict:
        """The rows (k), counted through all shards, of the columns `names` (all if None)."""
        order = torch.argsort(rows)
        back = torch.argsort(order)
        rows = rows[order]
        owner = torch.bucketize(rows, self._bounds, right=True)
        numbers, counts = (each.tolist() for each in owner.unique_consecutive(return_counts=True))
        starts = [0, *self._bounds.tolist()]
        parts = [part - starts[number] for number, part in zip(numbers, rows.split(counts), strict=True)]
        if not parts:  # an empty index, as other storages take it
            numbers, parts = [0], [rows]
        batch = TensorDict({}, rows.shape)
        for name in self._names if names is None else names:
            columns = self._get_columns(name)
            picked = [
                columns[number].index_select(0, part) for number, part in zip(numbers, parts, strict=True)
            ]
            batch[name] = torch.cat(picked)[back]
        return batch

    def _get_columns(self, name: NestedKey) -> list[Tensor]:
        """The column of each shard, as plain views of the mapped files, which torch reads faster."""
        if name not in self._columns:
            self._columns[name] = [rows.get(name).as_subclass(Tensor) for rows in self._shards]
        return self._columns[name]

    def __getstate__(self) -> dict[str, Any]:
        # Mapped files are handed over by name, plain views of them would be as copies.
        return {**super().__getstate__(), "_columns": {}}

    def set(self, cursor: Any, data: Any, *, set_cursor: bool = True) -> None:
        """Refused: the files are shared and guarded by checksums."""
        raise ConfigError(
            "Demonstrations on disk are read-only: extend a MixtureReplayBuffer with them instead."
        )

    def _empty(self) -> None:
        raise ConfigError(
            "Demonstrations on disk are read-only: make another buffer instead of emptying this."
        )

    def state_dict(self) -> dict[str, Any]:
        """How many transitions there are; they stay in their files."""
        return {"transitions": len(self)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Check that the files are as many as they were."""
        if state_dict["transitions"] != len(self):
            raise ConfigError(
                f"A buffer over {state_dict['transitions']} transitions cannot go on over {len(self)}: "
                "open the demonstrations that it was made with."
            )
