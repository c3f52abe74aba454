"""Rows of any TorchRL storage as flat numbers, and single columns of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDictBase, is_tensor_collection
from torch import Tensor
from torchrl.data.replay_buffers.storages import Storage, TensorStorage

from torchgrasp.errors import ConfigError

# Whole rows that a storage without columns hands out in one piece.
_AT_ONCE = 4096


def flatten_index(storage: Storage, index: int | Tensor) -> Tensor:
    """Where rows lie, (k) or (k, ndim) as TorchRL counts, as flat row numbers (k) int64."""
    index = torch.as_tensor(index).cpu()
    if storage.ndim == 1:
        return index.reshape(-1)
    columns = index.reshape(-1, storage.ndim).unbind(-1)
    rows = columns[0]
    for size, column in zip(storage.shape[1:], columns[1:], strict=True):
        rows = rows * size + column
    return rows


def unflatten_index(storage: Storage, rows: Tensor) -> Tensor | tuple[Tensor, ...]:
    """Undo `flatten_index`: an index that `storage` takes, with ``ndim`` above 1 a tuple."""
    return rows if storage.ndim == 1 else torch.unravel_index(rows, storage.shape)


def find_filled_rows(storage: Storage) -> Tensor:
    """(k) flat numbers of the rows that `storage` holds."""
    # MixtureStorage has gaps between its sources.
    find = getattr(storage, "filled_rows", None)
    return torch.arange(len(storage)) if find is None else find()  # pyright: ignore[reportArgumentType]


def read_columns(storage: Storage, rows: Tensor, keys: Sequence[NestedKey]) -> TensorDictBase:
    """The `rows` (k, at least one) of `storage`, of `keys` alone (absent ones left out)."""
    read = getattr(storage, "read_columns", None)
    if read is not None:
        return read(rows, keys)
    if isinstance(storage, TensorStorage):
        # A slice is a view: the other columns are not read.
        return _select(storage.get(slice(None)), keys)[unflatten_index(storage, rows)]
    parts = [_select(cast(Any, storage).get(part), keys) for part in rows.split(_AT_ONCE)]
    return cast(TensorDictBase, torch.cat(cast(Any, parts)))


def _select(rows: Any, keys: Sequence[NestedKey]) -> TensorDictBase:
    if isinstance(rows, list):
        return torch.stack([_select(row, keys) for row in rows])  # pyright: ignore
    if not is_tensor_collection(rows):
        raise ConfigError(
            f"MixtureSampler was given a storage of {type(rows).__name__}s: store TensorDicts, whose rows "
            "say where they come from."
        )
    return rows.select(*keys, strict=False)
