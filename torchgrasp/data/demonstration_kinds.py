"""Kinds of demonstrations: who acted, and which of the steps each kind is collected for."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.errors import ConfigError

# Kind -> the steps that it is for.
KINDS = {"expert": "successful", "perturbed": "successful", "failed": "failed", "learner": "all"}
# Steps -> where the card counts them.
COUNTED = {"all": "steps", "successful": "successful_steps", "failed": "failed_steps"}


def check_kind(kind: str) -> str:
    """`kind` itself, or ConfigError where there is none of that name."""
    if kind not in KINDS:
        raise ConfigError(f"kind={kind!r} is unknown: give one of {', '.join(KINDS)}.")
    return kind


def resolve_count(count: str | None, kind: str) -> str:
    """Which steps count: `count` (all, successful or failed), or where it is None those that `kind` is for.

    >>> resolve_count(None, "perturbed"), resolve_count("all", "perturbed")
    ('successful', 'all')
    """
    if count is None:
        return KINDS[check_kind(kind)]
    if kind == "failed" and count == "successful":
        raise ConfigError("kind=failed keeps nothing that count=successful counts: leave count out.")
    if count not in COUNTED:
        raise ConfigError(f"count={count!r} is unknown: give one of {', '.join(COUNTED)}.")
    return count


def find_counted(rows: TensorDictBase, count: str) -> Tensor:
    """(R) bool: those of `rows` (R) whose episodes count: `count` is all, successful or failed."""
    success = rows[keys.EPISODE_SUCCESS].squeeze(-1)
    if resolve_count(count, "learner") == "all":
        return torch.ones_like(success)
    return success if count == "successful" else ~success
