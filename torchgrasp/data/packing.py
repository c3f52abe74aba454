"""Nested Python state as JSON and named tensors, and back, exactly and without pickle."""

from __future__ import annotations

import base64
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from torchgrasp.errors import CheckpointError

_TAG = "$"


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
        return {_TAG: "tensor", "name": _store(value.detach(), path, tensors)}
    if isinstance(value, TensorDictBase):
        items = dict(value.items())
        return {_TAG: "tensordict", "shape": list(value.shape), "items": _pack(items, path, tensors)}
    if isinstance(value, np.ndarray):
        return {_TAG: "ndarray", "name": _store(_from_numpy(value), path, tensors)}
    if isinstance(value, np.generic):
        return {_TAG: "scalar", "dtype": value.dtype.name, "value": value.item()}
    if isinstance(value, bytes):
        return {_TAG: "bytes", "value": base64.b64encode(value).decode()}
    if isinstance(value, (torch.device, torch.dtype)):
        return {_TAG: type(value).__name__, "value": str(value).removeprefix("torch.")}
    if isinstance(value, Mapping):
        return _pack_mapping(value, path, tensors)
    if isinstance(value, (list, tuple)):
        items = [_pack(item, (*path, str(i)), tensors) for i, item in enumerate(value)]
        tag = {list: None, tuple: "tuple", torch.Size: "size"}.get(type(value), "unknown")
        if tag != "unknown":
            return items if tag is None else {_TAG: tag, "items": items}
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
    return {_TAG: "ordered" if isinstance(value, OrderedDict) else "dict", "items": pairs}


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


def unpack_tree(value: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Undo `pack_tree`."""
    if isinstance(value, list):
        return [unpack_tree(item, tensors) for item in value]
    if not isinstance(value, dict):
        return value
    if _TAG not in value:
        return {key: unpack_tree(item, tensors) for key, item in value.items()}
    return _UNPACKERS[value[_TAG]](value, tensors)


def _unpack_pairs(value: dict, tensors: Mapping[str, Tensor]) -> list[tuple]:
    return [(unpack_tree(key, tensors), unpack_tree(item, tensors)) for key, item in value["items"]]


_UNPACKERS: dict[str, Callable[[dict, Mapping[str, Tensor]], Any]] = {
    "tensor": lambda v, t: t[v["name"]],
    "ndarray": lambda v, t: t[v["name"]].numpy(),
    "tensordict": lambda v, t: TensorDict(unpack_tree(v["items"], t), v["shape"]),
    "scalar": lambda v, t: np.dtype(v["dtype"]).type(v["value"]),
    "bytes": lambda v, t: base64.b64decode(v["value"]),
    "device": lambda v, t: torch.device(v["value"]),
    "dtype": lambda v, t: getattr(torch, v["value"]),
    "tuple": lambda v, t: tuple(unpack_tree(v["items"], t)),
    "size": lambda v, t: torch.Size(v["items"]),
    "dict": lambda v, t: dict(_unpack_pairs(v, t)),
    "ordered": lambda v, t: OrderedDict(_unpack_pairs(v, t)),
}
