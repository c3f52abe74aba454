"""MixtureStorage: one ring of rows per source behind one flat index, next states not stored twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from multiprocessing.context import get_spawning_popen
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data.replay_buffers.storages import LazyMemmapStorage, LazyTensorStorage, Storage

from torchgrasp.data.buffer_memory import check_space, count_row_bytes
from torchgrasp.data.state_files import StateFiles
from torchgrasp.errors import ConfigError, TorchgraspError

SUCCESSOR = "successor"


class MixtureStorage(StateFiles, Storage):
    """A TorchRL storage that keeps each source in its own region, so that none overwrites another.

    Row `i` of the k-th source has the flat index `offsets[k] + i`. Regions are TorchRL's
    LazyTensorStorage or, given a `folder`, LazyMemmapStorage, made when their source's first rows
    arrive, or when the storage is shared with other processes; before the first rows the memory or disk
    they will take is compared with what is free.

    With `next_keys`, rows must be written in order of time, and a row's next values of these keys
    are read from the row that was written after it: `get` adds ("next", key). Every row up to the
    last of a write has its successor in that write, and a ring that is written in order loses a row
    before its successor, so that the link never leads to another trajectory. Rows whose `end_keys`
    hold a true value link to themselves: nothing may be read from their ("next", key).

    Args:
        capacities: source name -> rows.
        folder: where rows are kept on disk; in memory if None.
        next_keys: observation keys whose next values are read from the following row.
        end_keys: bool keys (*, 1) that mark rows without a successor.

    >>> storage = MixtureStorage({"online": 4, "expert": 2})
    >>> storage.set(torch.tensor([0, 4]), TensorDict({"x": torch.tensor([1.0, 2.0])}, [2]))
    >>> len(storage), storage.get(torch.tensor([4]))["x"]
    (2, tensor([2.]))
    """

    def __init__(
        self,
        capacities: Mapping[str, int],
        *,
        folder: str | Path | None = None,
        next_keys: Sequence[NestedKey] = (),
        end_keys: Sequence[NestedKey] = ("terminated", "stub"),
    ) -> None:
        self.capacities = {str(name): int(rows) for name, rows in capacities.items()}
        for name, rows in self.capacities.items():
            if rows < 1:
                raise ConfigError(f"capacities[{name!r}]={rows}: give at least one row, or drop the source.")
        super().__init__(sum(self.capacities.values()))
        self.offsets = dict(zip(self.capacities, accumulate((0, *self.capacities.values())), strict=False))
        self._ends = torch.tensor(list(accumulate(self.capacities.values())))
        self._folder = None if folder is None else Path(folder)
        self._next_keys, self._end_keys = tuple(next_keys), tuple(end_keys)
        self._columns: dict[str, dict[Any, Tensor]] = {}
        self._columns_revision = -1
        self._regions: dict[str, Any] = {name: self._make_region(name) for name in self.capacities}

    def _make_region(self, name: str) -> LazyTensorStorage:
        if self._folder is None:
            return LazyTensorStorage(self.capacities[name])
        return LazyMemmapStorage(self.capacities[name], scratch_dir=self._folder / name, existsok=True)

    @property
    def spans(self) -> dict[str, range]:
        """The flat indices of each source."""
        return {name: range(start, start + self.capacities[name]) for name, start in self.offsets.items()}

    def num_rows(self) -> dict[str, int]:
        """Rows that each source holds, those that are no transitions included."""
        return {name: len(region) for name, region in self._regions.items()}

    def __len__(self) -> int:
        return sum(map(len, self._regions.values()))

    def set(self, cursor: int | Tensor, data: TensorDictBase, *, set_cursor: bool = True) -> None:
        """Write rows `data` (k) at the flat indices `cursor` (k)."""
        index = torch.as_tensor(cursor).reshape(-1)
        data = data.reshape(index.numel())
        if set_cursor:
            self._set_last_cursor(index)
        if not any(region.initialized for region in self._regions.values()):
            check_space(self.max_size, count_row_bytes(data), folder=self._folder)
        if self._next_keys:
            data = data.copy().set(SUCCESSOR, self._link(index, data))
        owner = torch.bucketize(index, self._ends, right=True)
        for number in owner.unique().tolist():
            name, mine = list(self._regions)[number], owner == number
            rows = data if bool(mine.all()) else data[mine]
            self._write(self._regions[name], index[mine] - self.offsets[name], rows)
        self._bump_mutation_revision()

    @staticmethod
    def _write(region: Any, index: Tensor, rows: TensorDictBase) -> None:
        # set_cursor makes the region count its rows: right for rows appended to a ring, wrong for
        # rows that only replace others.
        region.set(index, rows, set_cursor=bool(index.max() >= len(region)))

    def _link(self, index: Tensor, data: TensorDictBase) -> Tensor:
        following = torch.cat((index[1:], index[-1:]))
        for key in self._end_keys:
            end = data.get(key, None)
            if end is not None:
                following = torch.where(end.reshape(-1).to(index.device), index, following)
        return following

    def get(self, index: Any) -> TensorDictBase:
        """Rows at flat `index` (int, slice, or integers of any shape), with ("next", key) where linked."""
        if isinstance(index, slice):
            index = self.filled_rows()[index]
        index = torch.as_tensor(index)
        rows = self.read_columns(index.reshape(-1), None)
        if self._next_keys:
            rows["next"] = self.read_columns(rows.pop(SUCCESSOR), self._next_keys)
        return rows.reshape(index.shape)

    def read_columns(self, index: Tensor, keys: Sequence[NestedKey] | None) -> TensorDictBase:
        """Rows at the flat indices `index` (k), of `keys` alone (all if None; absent ones left out)."""
        owner = torch.bucketize(index, self._ends, right=True)
        order = None
        if bool((owner[1:] < owner[:-1]).any()):
            order = torch.argsort(owner, stable=True)
            index, owner = index[order], owner[order]
        counts = torch.bincount(owner, minlength=len(self._regions)).tolist()
        named = zip(self._regions, index.split(counts), strict=True)
        parts = [(name, part - self.offsets[name]) for name, part in named if part.numel()]
        filled = [(name, index) for name, rows in self.num_rows().items() if rows]
        rows = self._gather(parts or filled[:1], keys)
        return rows if order is None else rows[torch.argsort(order)]

    def _gather(self, parts: Sequence[tuple[str, Tensor]], keys: Sequence[NestedKey] | None) -> TensorDict:
        """Rows of the regions named, one after the other, each column read straight into its place."""
        names = self._get_columns(parts[0][0])
        size = sum(part.numel() for _, part in parts)
        rows: dict[Any, Tensor] = {}
        for key in names if keys is None else (key for key in map(unravel_key, keys) if key in names):
            column = rows[key] = names[key].new_empty(size, *names[key].shape[1:])
            pieces = column.split([part.numel() for _, part in parts])
            for (name, part), piece in zip(parts, pieces, strict=True):
                # index_select copies whole rows; indexing with a tensor goes element by element.
                torch.index_select(self._get_columns(name)[key], 0, part, out=piece)
        return TensorDict(rows, [size])

    def _get_columns(self, name: str) -> dict[Any, Tensor]:
        """The filled part of each column of a region, as plain views, until the next write of any process."""
        revision = self._mutation_revision
        if revision != self._columns_revision:
            self._columns, self._columns_revision = {}, int(revision)
        if name not in self._columns:
            rows = self._regions[name].get(slice(None))
            self._columns[name] = {key: value.as_subclass(Tensor) for key, value in rows.items(True, True)}
        return self._columns[name]

    def __getstate__(self) -> dict[str, Any]:
        if get_spawning_popen() is not None:
            self._make_every_region()
        # Mapped files are handed over by name, plain views of them would be as copies.
        return {**super().__getstate__(), "_columns": {}, "_columns_revision": -1}

    def _make_every_region(self) -> None:
        """Give each source its memory now: a region made later is not seen by other processes."""
        regions = list(self._regions.values())
        made = next((region for region in regions if region.initialized), None)
        if made is None:
            # Not a ConfigError: TorchRL's collectors swallow every ValueError here.
            raise TorchgraspError(
                "A replay buffer without rows was given to other processes: extend it first, with "
                "demonstrations or one rollout, so that its memory is there to be shared."
            )
        for region in regions:
            if not region.initialized:
                region.set(torch.tensor([0]), made._storage[:1])
                region._empty()

    def filled_rows(self) -> Tensor:
        """(k) int64: the flat indices that hold rows."""
        regions = self._regions.items()
        return torch.cat([self.offsets[name] + torch.arange(len(region)) for name, region in regions])

    def _empty(self) -> None:
        for region in self._regions.values():
            region._empty()
        self._bump_mutation_revision()

    def contains(self, item: int | Tensor) -> Tensor | bool:
        """Whether flat index `item` holds a row."""
        found = torch.isin(torch.as_tensor(item), self.filled_rows())
        return found if isinstance(item, Tensor) else bool(found)

    def state_dict(self) -> dict[str, Any]:
        """The filled rows of each source (views, not copies) under flattened keys."""
        rows = {}
        for name, region in self._regions.items():
            if len(region):
                flat = region.get(slice(None)).flatten_keys(".")
                rows[name] = {str(key): value for key, value in flat.items()}
        return {"capacities": dict(self.capacities), "rows": rows}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Undo `state_dict`; the capacities must be the same."""
        if state_dict["capacities"] != self.capacities:
            raise ConfigError(
                f"A buffer of capacities {state_dict['capacities']} cannot be loaded into one of "
                f"{self.capacities}: build it with the saved ones."
            )
        self._empty()
        for name, columns in state_dict["rows"].items():
            self._check_columns(name, columns)
            rows = TensorDict(columns, [next(iter(columns.values())).shape[0]]).unflatten_keys(".")
            self._regions[name].set(slice(0, rows.shape[0]), rows)
        self._bump_mutation_revision()

    def _check_columns(self, name: str, columns: Any) -> None:
        """Refuse columns that are no rows of the source `name`, before any are written."""
        tensors = columns.values() if isinstance(columns, Mapping) else [None]
        sizes = {len(each) if isinstance(each, Tensor) and each.ndim else -1 for each in tensors}
        if len(sizes) != 1 or not 0 < max(sizes) <= self.capacities.get(name, 0):
            raise ConfigError(
                f"rows[{name!r}] are no columns of equal length, up to the source's capacity: load what "
                "state_dict gave."
            )
        links = columns.get(SUCCESSOR, torch.zeros(0, dtype=torch.int64))
        known = links.dtype == torch.int64 and bool(((links >= 0) & (links < self.max_size)).all())
        if not known or (SUCCESSOR in columns) != bool(self._next_keys):
            raise ConfigError(f"rows[{name!r}] have other links than this storage: build it as it was saved.")


def keep_batch(batch: TensorDictBase) -> TensorDictBase:
    """The `collate_fn` of a TorchRL buffer over a storage of this package: batches are whole already."""
    return batch
