"""Whether a state that was read has the same kinds of values as the one that it takes the place of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp.documents import shorten

# Beyond this no count of anything comes.
_MOST = 2**53


def find_unlike(found: Any, like: Any, place: str = "it") -> str | None:
    """Where a nested state `found` cannot take the place of `like`, in words; None where it can.

    Types are the same, and so are the names in a dictionary, the length of a list (unless of tensors alone),
    and a tensor's dtype and shape but for its first size. What is empty in `like`, as before a first step,
    may be filled, a list with plain values of one type; what is None may be a number. Numbers that begin at 0
    or more are finite and stay so.

    >>> find_unlike({"step": -3}, {"step": 0})
    'step is -3'
    """
    if like is None:
        known = found is None or (type(found) is float and abs(found) <= _MOST)
        return None if known else _tell(found, place)
    if not _are_of_one_type(found, like):
        return _tell(found, place)
    if isinstance(like, TensorDictBase):
        same = found.batch_size[1:] == like.batch_size[1:] and found.ndim == like.ndim
        return _find_in_dict(dict(found.items()), dict(like.items()), place) if same else _tell(found, place)
    if isinstance(like, dict):
        return _find_in_dict(found, like, place)
    if isinstance(like, list | tuple):
        return _find_in_list(found, like, place)
    if isinstance(like, Tensor | np.ndarray):
        same = found.dtype == like.dtype and found.shape[1:] == like.shape[1:] and found.ndim == like.ndim
        return None if same else f"{place} is {found.dtype} of shape {list(found.shape)}"
    if isinstance(like, np.generic):
        found, like = found.item(), like.item()
    if isinstance(like, int | float) and not isinstance(like, bool):
        return None if _could_be(found, like) else _tell(found, place)
    return None


def _are_of_one_type(found: Any, like: Any) -> bool:
    # Parameters and mapped tensors are saved as tensors.
    return isinstance(found, Tensor) if isinstance(like, Tensor) else type(found) is type(like)


def _find_in_dict(found: dict[Any, Any], like: dict[Any, Any], place: str) -> str | None:
    if like and found.keys() != like.keys():
        names = shorten(sorted(map(str, found.keys() ^ like.keys())))
        return f"{place} has not the entries that are wanted: {names} are there or not"
    places = {name: str(name) if place == "it" else f"{place}.{name}" for name in like}
    unlike = (find_unlike(found[name], value, places[name]) for name, value in like.items())
    return next((words for words in unlike if words is not None), None)


def _find_in_list(found: Any, like: Any, place: str) -> str | None:
    if all(isinstance(each, Tensor) for each in (*found, *like)):
        return None  # of as many devices as there were
    if not like:
        alike = any(all(type(each) is kind for each in found) for kind in (bool, int, float, str))
        return None if alike else _tell(found, place)
    if len(found) != len(like):
        return f"{place} has {len(found)} entries instead of {len(like)}"
    pairs = enumerate(zip(found, like, strict=True))
    unlike = (find_unlike(each, other, f"{place}.{number}") for number, (each, other) in pairs)
    return next((words for words in unlike if words is not None), None)


def _could_be(found: float, like: float) -> bool:
    if isinstance(found, float) and not math.isfinite(found):
        return not math.isfinite(like)
    return (found >= 0 or like < 0) and (abs(found) <= _MOST or abs(like) > _MOST)


def _tell(found: Any, place: str) -> str:
    return f"{place} is {shorten(found)}"
