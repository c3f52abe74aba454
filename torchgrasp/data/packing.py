"""Nested Python state as JSON and named tensors, and back, exactly and without pickle."""

from __future__ import annotations

import base64
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field, ValidationError
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from torchgrasp.documents import Count, Document, Name, shorten
from torchgrasp.errors import CheckpointError

_TAG = "$"


class _Stored(Document):
    name: str


class _Shaped(Document):
    shape: list[Count]
    items: Any


class _Scalar(Document):
    dtype: Name
    value: bool | int | float


class _Word(Document):
    value: str


class _Items(Document):
    items: list[Any]


class _Sizes(Document):
    items: list[Count]


class _Pairs(Document):
    items: list[Annotated[list[Any], Field(min_length=2, max_length=2)]]


def pack_tree(tree: Any) -> tuple[Any, dict[str, Tensor]]:
    """Nested state to (value that JSON takes, tensors by dotted name).

    Takes dicts (any scalar keys, order kept), lists, tuples, None, bool, int, float, str, bytes,
    tensors, TensorDicts, numpy arrays and scalars, torch.device, torch.dtype and torch.Size.

    >>> pack_tree({"lr": 0.1, "state": {0: {"step": torch.tensor(3.0)}}})[1]
    {'state.0.step': tensor(3.)}
    """
    tensors: dict[str, Tensor] = {}
    return _pack(tree, (), tensors), tensors


def _pack(value: Any, path: tuple[str, ...], tensors: dict[str, Tensor]) -> Any:
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, Tensor):
        return _make_node("tensor", name=_store(value.detach(), path, tensors))
    if isinstance(value, TensorDictBase):
        items = dict(value.items())
        return _make_node("tensordict", shape=list(value.shape), items=_pack(items, path, tensors))
    if isinstance(value, np.ndarray):
        return _make_node("ndarray", name=_store(_from_numpy(value), path, tensors))
    if isinstance(value, np.generic) and value.dtype.kind in "biuf":
        return _make_node("scalar", dtype=value.dtype.name, value=value.item())
    if isinstance(value, bytes):
        return _make_node("bytes", value=base64.b64encode(value).decode())
    if isinstance(value, (torch.device, torch.dtype)):
        return _make_node(type(value).__name__, value=str(value).removeprefix("torch."))
    if isinstance(value, Mapping):
        return _pack_mapping(value, path, tensors)
    if isinstance(value, (list, tuple)):
        items = [_pack(item, (*path, str(i)), tensors) for i, item in enumerate(value)]
        tag = {list: None, tuple: "tuple", torch.Size: "size"}.get(type(value), "unknown")
        if tag != "unknown":
            return items if tag is None else _make_node(tag, items=items)
    raise CheckpointError(
        f"{'.'.join(path) or 'the state'} is a {type(value).__name__}, which is not saved without "
        "pickle: turn it into tensors, numbers, strings, lists or dicts in its state_dict."
    )


def _pack_mapping(value: Mapping, path: tuple[str, ...], tensors: dict[str, Tensor]) -> Any:
    if type(value) is dict and all(type(key) is str for key in value) and _TAG not in value:
        return {key: _pack(item, (*path, key), tensors) for key, item in value.items()}
    pairs = [
        [_pack(key, (*path, "key"), tensors), _pack(item, (*path, str(key)), tensors)]
        for key, item in value.items()
    ]
    return _make_node("ordered" if isinstance(value, OrderedDict) else "dict", items=pairs)


def _make_node(kind: str, **fields: Any) -> dict[str, Any]:
    """A value that JSON has no word for, as it is written: its kind under `$` beside what it takes."""
    _KINDS[kind][0].model_validate(fields)
    return {_TAG: kind, **fields}


def _store(value: Tensor, path: tuple[str, ...], tensors: dict[str, Tensor]) -> str:
    base = name = ".".join(path) or "value"
    while name in tensors:  # {"a.b": x, "a": {"b": y}}
        name += "'"
    if value.layout != torch.strided:
        raise CheckpointError(f"{base} is a {value.layout} tensor: make it dense before saving it.")
    tensors[name] = value
    return name


def _from_numpy(value: np.ndarray) -> Tensor:
    try:
        # ascontiguousarray would turn a number of shape () into one of shape (1,).
        return torch.from_numpy(value.copy(order="C"))
    except TypeError as error:
        raise CheckpointError(f"A numpy array of {value.dtype} is not saved: {error}") from error


def unpack_tree(tree: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Undo `pack_tree`; ValueError where `tree` is none of its making, or `tensors` are others."""
    left = dict(tensors)
    value = _unpack(tree, left)
    if left:
        raise ValueError(f"nothing refers to its tensor {shorten(min(left))}")
    return value


def _unpack(value: Any, left: dict[str, Tensor]) -> Any:
    if isinstance(value, list):
        return [_unpack(item, left) for item in value]
    if not isinstance(value, dict):
        return value
    if _TAG not in value:
        return {key: _unpack(item, left) for key, item in value.items()}
    fields = dict(value)
    kind = fields.pop(_TAG)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"{shorten(kind)} is no kind of value")
    schema, unpack = _KINDS[kind]
    try:
        return unpack(schema.model_validate(fields), left)
    except ValidationError as error:
        raise ValueError(f"a {kind} cannot be {shorten(fields)}") from error
    except (TypeError, RuntimeError, OverflowError) as error:
        raise ValueError(f"a {kind} cannot be {shorten(fields)} ({error})") from error


def _take(node: _Stored, left: dict[str, Tensor]) -> Tensor:
    if node.name not in left:
        raise ValueError(f"it has no tensor {shorten(node.name)}, or refers to it twice")
    return left.pop(node.name)


def _unpack_scalar(node: _Scalar) -> np.generic:
    dtype = np.dtype(node.dtype)
    if dtype.kind not in "biuf":
        raise TypeError("no number")
    number = dtype.type(node.value)
    same = number.item() == node.value or node.value != node.value
    if not same or type(number.item()) is not type(node.value):
        raise TypeError("no such number")
    return number


def _unpack_tensordict(node: _Shaped, left: dict[str, Tensor]) -> TensorDict:
    items = _unpack(node.items, left)
    if not isinstance(items, dict):
        raise TypeError("no items")
    return TensorDict(items, node.shape)


def _unpack_dtype(node: _Word) -> torch.dtype:
    dtype = getattr(torch, node.value, None)
    if not isinstance(dtype, torch.dtype):
        raise TypeError("no dtype")
    return dtype


def _unpack_pairs(node: _Pairs, left: dict[str, Tensor]) -> list[tuple]:
    return [(_unpack(key, left), _unpack(item, left)) for key, item in node.items]


# What a kind of value takes, and how it is made of that.
_KINDS: dict[str, tuple[type[Document], Callable[[Any, dict[str, Tensor]], Any]]] = {
    "tensor": (_Stored, _take),
    "ndarray": (_Stored, lambda node, left: _take(node, left).numpy()),
    "tensordict": (_Shaped, _unpack_tensordict),
    "scalar": (_Scalar, lambda node, _: _unpack_scalar(node)),
    "bytes": (_Word, lambda node, _: base64.b64decode(node.value, validate=True)),
    "device": (_Word, lambda node, _: torch.device(node.value)),
    "dtype": (_Word, lambda node, _: _unpack_dtype(node)),
    "tuple": (_Items, lambda node, left: tuple(_unpack(node.items, left))),
    "size": (_Sizes, lambda node, _: torch.Size(node.items)),
    "dict": (_Pairs, lambda node, left: dict(_unpack_pairs(node, left))),
    "ordered": (_Pairs, lambda node, left: OrderedDict(_unpack_pairs(node, left))),
}
