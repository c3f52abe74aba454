"""Rows on disk as TensorDict.memmap wrote them, mapped for reading alone: their files stay as they are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import unquote

import torch
from pydantic import AfterValidator, Field
from tensordict import MemoryMappedTensor, TensorDict, TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.data.sampler import STUB
from torchgrasp.documents import Count, Document, check_document, read_json, reading, shorten
from torchgrasp.errors import DamageError

_META = "meta.json"
_DTYPES = {
    str(dtype): dtype
    for dtype in (
        *(torch.float16, torch.float32, torch.float64, torch.uint8, torch.int8),
        *(torch.int16, torch.int32, torch.int64, torch.bool),
    )
}
# Folders of columns within folders of columns: keys of this many parts.
_MAX_PARTS = 4
_Shape = Annotated[list[Count], Field(min_length=1, max_length=8)]


def _check_dtype(name: str) -> str:
    if name not in _DTYPES:
        raise ValueError(f"one of {', '.join(_DTYPES)}")
    return name


class Column(Document):
    """What meta.json says of a column's file."""

    device: Literal["cpu"]
    shape: _Shape
    dtype: Annotated[str, AfterValidator(_check_dtype)]
    is_nested: Literal[False] = False


class Group(Document):
    """What meta.json says of columns in a folder of their own."""

    type: Literal["TensorDict"]


class RowsMeta(Document):
    """meta.json of a folder of rows, its columns apart."""

    shape: _Shape
    device: Literal["cpu", "None"] = "None"
    kind: Annotated[str, Field(alias="_type", pattern="TensorDict")]


class _ReadOnlyTensor(MemoryMappedTensor):
    """A mapped file that is never written: what is changed in memory stays there."""

    @classmethod
    def from_filename(cls, filename: Any, dtype: torch.dtype, shape: Any, index: Any = None) -> Any:
        """The tensor in a file of at least that size; processes that it is handed to open it so, too."""
        shape = torch.Size(shape)
        tensor = torch.from_file(str(filename), shared=False, dtype=dtype, size=shape.numel()).view(shape)
        mapped: Any = cls(tensor if index is None else tensor[index])
        mapped.filename, mapped._handler, mapped.index, mapped.parent_shape = filename, None, index, shape
        return mapped


def map_rows(folder: Path, remedy: str) -> TensorDict:
    """Rows (R) of a folder that TensorDict.memmap wrote, read-only; without a key where there is none.

    Nothing is opened before its size is what meta.json tells; DamageError names a file that is not so.
    """
    return _map_group(folder, remedy, []) if folder.exists() else TensorDict({}, [0])


def _map_group(folder: Path, remedy: str, parts: list[str]) -> TensorDict:
    file = folder / _META
    meta = read_json(file, remedy, error=DamageError)
    if not isinstance(meta, dict) or len(parts) > _MAX_PARTS:
        raise DamageError(f"{file} cannot be used (it holds {shorten(meta)}): {remedy}.")
    columns = {name: meta.pop(name) for name, value in list(meta.items()) if isinstance(value, dict)}
    told = check_document(meta, RowsMeta, file, remedy, error=DamageError)
    with reading(folder, remedy):
        # Names as they are in keys, of which some characters are escaped in files; hidden files are systems'.
        found = {unquote(each.name): each for each in folder.iterdir() if each.name[0] != "."}
    found.pop(_META, None)
    tensors: dict[str, Tensor | TensorDict] = {}
    for name, value in columns.items():
        place = f"{file}: {shorten(name)}"
        if "type" in value:
            check_document(value, Group, place, remedy, error=DamageError)
            if name not in found:
                raise DamageError(f"{place}: its folder is missing: {remedy}.")
            tensors[name] = _map_group(found.pop(name), remedy, [*parts, name])
        else:
            column = check_document(value, Column, place, remedy, error=DamageError)
            tensors[name] = _map_column(found.pop(f"{name}.memmap", None), column, place, remedy)
    if found:
        raise DamageError(f"{file} tells nothing of {shorten(sorted(found))} beside it: {remedy}.")
    try:
        return TensorDict(tensors, told.shape, device=None if told.device == "None" else told.device)
    except RuntimeError as error:
        raise DamageError(f"{file} has columns of other lengths than {told.shape}: {remedy}.") from error


def _map_column(file: Path | None, column: Column, told: str, remedy: str) -> Tensor:
    dtype, numel = _DTYPES[column.dtype], math.prod(column.shape)
    size = 0
    if file is not None:
        with reading(file, remedy):
            size = file.stat().st_size
    if size != numel * dtype.itemsize:
        raise DamageError(
            f"{told} of shape {shorten(column.shape)} and {column.dtype} has {size} bytes instead of "
            f"{numel * dtype.itemsize}: {remedy}."
        )
    try:
        if file is None or not numel:
            return torch.empty(column.shape, dtype=dtype)
        with reading(file, remedy):
            return _ReadOnlyTensor.from_filename(file, dtype, column.shape)
    except RuntimeError as error:
        raise DamageError(f"{told} cannot be mapped ({error}): {remedy}.") from error


_FLAGS = (STUB, "terminated", "done", keys.EPISODE_SUCCESS, keys.HAS_EXPERT, keys.HAS_GOAL, keys.PERTURBED)
_VECTORS = (keys.ACTION, keys.EXPERT_ACTION, keys.GOAL)


def check_columns(rows: TensorDictBase, folder: Path, remedy: str) -> None:
    """Refuse rows (R) without a column that CompactTransitions writes, or with another kind of entries in it.

    Flags are bool (1), the reward a number (1), actions and goals vectors of numbers.
    """
    if not len(rows):
        return
    for name in (*_FLAGS, "reward", *_VECTORS):
        value = rows.get(name, None)
        if not isinstance(value, Tensor) or value.ndim != 2 or not _fits(name, value):
            found = f"{value.dtype} of shape {list(value.shape)}" if isinstance(value, Tensor) else "nothing"
            raise DamageError(f"{folder} has {found} as {name!r}: {remedy}.")
    left = rows.get(keys.TIME_LEFT, None)
    if left is not None and left.ndim != 2:
        raise DamageError(f"{folder} has {keys.TIME_LEFT!r} of shape {list(left.shape)}: {remedy}.")
    if not bool((rows["terminated"] | rows[STUB])[-1]):
        raise DamageError(f"{folder} ends within an episode: {remedy}.")


def _fits(name: str, value: Tensor) -> bool:
    if name in _FLAGS:
        return value.dtype == torch.bool and value.shape[-1] == 1
    return value.is_floating_point() and (value.shape[-1] == 1 if name == "reward" else value.shape[-1] > 0)
