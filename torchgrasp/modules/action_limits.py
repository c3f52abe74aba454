"""The limits of an action, of its largest magnitudes or of an environment's spec."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor

from torchgrasp.errors import ConfigError
from torchgrasp.modules.heads import bound_tensor


def find_limits(
    action_bound: Sequence[float] | None, action_spec: Any, action_key: NestedKey
) -> tuple[Tensor, Tensor]:
    """Low and high of one action, (A,) each."""
    if (action_bound is None) == (action_spec is None):
        given = "are missing" if action_bound is None else "are given together"
        raise ConfigError(
            f"action_bound and action_spec {given}: give one of them, but not both, the bound as the largest "
            "magnitude of each component, such as [2.0] of one, or the spec as an environment has it."
        )
    if action_bound is not None:
        bound = bound_tensor(action_bound)
        return -bound, bound
    # By what they offer: networks load without TorchRL.
    spec = _leaf(action_spec, action_key) if hasattr(action_spec, "batch_size") else action_spec
    space: Any = getattr(spec, "space", None)
    if not hasattr(space, "low") or _is_unbounded(space.high):
        raise ConfigError(
            f"action_spec={type(spec).__name__} has no limits: give a Bounded spec, or action_bound."
        )
    low, high = (_one_row(limit, spec.shape[-1]) for limit in (space.low, space.high))
    if not (low.isfinite() & high.isfinite()).all():
        raise ConfigError(
            f"action_spec has the limits {low.tolist()} and {high.tolist()}, whose half range is "
            "infinite: give a Bounded spec of finite ones, or action_bound."
        )
    return low, high


def _is_unbounded(high: Tensor) -> bool:
    """Whether the limit is the largest number there is, as that of TorchRL's Unbounded."""
    return high.is_floating_point() and bool((high == torch.finfo(high.dtype).max).all())


def _leaf(spec: Any, action_key: NestedKey) -> Any:
    """The spec of the action: under its key, or the only one there is, as keys may be set later."""
    names = [key for key, leaf in spec.items(True, True) if leaf is not None]
    name = unravel_key(action_key)
    if name in names:
        return spec[name]
    if len(names) == 1:
        return spec[names[0]]
    raise ConfigError(
        f"action_spec={names} has no {name!r} among its keys: give the spec of the action alone, or "
        "action_bound."
    )


def _one_row(limit: Tensor, size: int) -> Tensor:
    """The limit (size,) of a batch's actions (*, size), which are to be alike."""
    rows = limit.reshape(-1, size)
    if (rows != rows[0]).any():
        raise ConfigError(
            "action_spec has other limits in one row of its batch than in the next: give the spec of one "
            "action, or action_bound."
        )
    return rows[0].clone()
