"""Columns of episodes of other formats, which anyone may have written: checked as they are read."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp.errors import ConfigError

Signature = dict[Any, tuple[tuple[int, ...], Any]]


def read_column(
    values: Any,
    name: str,
    *,
    lengths: Collection[int],
    shape: tuple[int, ...] | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """(T, *shape) values of one episode; ConfigError with `name` unless they are finite numbers like that.

    Args:
        values: what the format's reader gives; a column of numbers (T) also stands for the shape (1).
        name: of episode and column, for errors.
        lengths: those that T may have.
        shape: of an entry; None for any.
        dtype: that they are converted to; None to keep theirs. Of bool, values must be 0 or 1.
    """
    array = _to_array(values, name)
    if shape == (1,) and array.ndim == 1:
        array = array[:, None]
    if not array.ndim or len(array) not in lengths or (shape is not None and array.shape[1:] != shape):
        entry = "..." if shape is None else ", ".join(map(str, shape))
        expected = " or ".join(f"({length}, {entry})" for length in sorted(set(lengths)))
        raise ConfigError(f"{name} has the shape {array.shape}, expected {expected}: mend the dataset.")
    value = torch.from_numpy(array)
    if dtype == torch.bool and not bool(((value == 0) | (value == 1)).all()):
        raise ConfigError(f"{name} holds other values than 0 and 1: give flags.")
    value = value if dtype is None else value.to(dtype)
    if not bool(value.isfinite().all()):
        raise ConfigError(f"{name} holds NaN, or values beyond {value.dtype}: mend the dataset.")
    return value


def _to_array(values: Any, name: str) -> Any:
    try:
        array = np.asarray(values)
    except ValueError as error:  # a list of entries of several shapes
        raise ConfigError(f"{name} is no column ({error}): give entries of one shape.") from error
    if array.dtype.kind not in "fiub":
        raise ConfigError(f"{name} holds values of type {array.dtype}: give numbers.")
    return array


def check_end(flags: Tensor, name: str) -> None:
    """Refuse an episode whose `flags` (T, 1) bool tell of an end before its last step."""
    ends = flags[:-1].nonzero()
    if len(ends):
        raise ConfigError(
            f"{name} is true at step {int(ends[0, 0])} of {len(flags)}: an episode ends at its last step "
            "alone, split the dataset's there."
        )


def check_alike(number: int, rows: TensorDictBase, first: Signature | None) -> Signature:
    """Refuse rows (R) of episode `number` whose columns differ from `first`, what this gave for another."""
    signature: Signature = {
        name: (tuple(rows[name].shape[1:]), rows[name].dtype) for name in rows.keys(True, True)
    }
    for name in sorted(signature.keys() | (first or signature).keys(), key=str):
        expected, found = (first or signature).get(name), signature.get(name)
        if expected != found:
            raise ConfigError(
                f"Episode {number} has {name!r} of {found}, episodes before it of {expected}: "
                "all must have the same columns."
            )
    return signature
