"""Target policy smoothing of TD3 (Fujimoto et al. 2018), within the action's limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.data import Bounded, Composite, TensorSpec

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.modules.heads import bound_tensor


class TargetSmoothing(nn.Module):
    """Adds clipped normal noise to actions (*, A) and clips them to their limits.

    Args:
        policy_noise: standard deviation, in units of each component's half range.
        noise_clip: largest magnitude of the noise, in the same units.
        action_bound: largest magnitude of each component.
        action_spec: instead of it, the action's Bounded spec, or a Composite that holds it.
        action_key: of the action in a Composite of several specs.
        generator: of the noise; torch's own without one.

    Example:
        >>> smoothing = TargetSmoothing(policy_noise=0.0, noise_clip=0.5, action_bound=[2.0])
        >>> smoothing(torch.tensor([[1.0], [-3.0]])).tolist()
        [[1.0], [-2.0]]
    """

    low: Tensor
    high: Tensor

    def __init__(
        self,
        *,
        policy_noise: float,
        noise_clip: float,
        action_bound: Sequence[float] | None = None,
        action_spec: TensorSpec | None = None,
        action_key: NestedKey = "action",
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        check_range("policy_noise", policy_noise, 0.0, float("inf"))
        check_range("noise_clip", noise_clip, 0.0, float("inf"))
        self.policy_noise, self.noise_clip, self.generator = policy_noise, noise_clip, generator
        low, high = _limits(action_bound, action_spec, action_key)
        # Configuration: they move along, but no checkpoint overwrites them.
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", high, persistent=False)

    def forward(self, action: Tensor) -> Tensor:
        """(*, A) actions to noisy ones within the limits."""
        if self.low.numel() != action.shape[-1]:
            raise ConfigError(
                f"the limits have {self.low.numel()} components and the action {action.shape[-1]}: "
                "give action_bound or action_spec of the action's size."
            )
        low, high = self.low.to(action), self.high.to(action)
        if self.policy_noise == 0:
            return action.clamp(low, high)
        noise = torch.randn(action.shape, generator=self.generator, dtype=action.dtype, device=action.device)
        noise = (self.policy_noise * noise).clamp(-self.noise_clip, self.noise_clip)
        return (action + noise * (high - low) / 2).clamp(low, high)


def _limits(
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
    spec = _leaf(action_spec, action_key) if isinstance(action_spec, Composite) else action_spec
    if not isinstance(spec, Bounded):
        raise ConfigError(
            f"action_spec={type(spec).__name__} has no limits: give a Bounded spec, or action_bound."
        )
    space: Any = spec.space
    low, high = (_one_row(limit, spec.shape[-1]) for limit in (space.low, space.high))
    if not (low.isfinite() & high.isfinite()).all():
        raise ConfigError(
            f"action_spec has the limits {low.tolist()} and {high.tolist()}, whose half range is the unit of "
            "the noise: give a Bounded spec of finite ones, or action_bound."
        )
    return low, high


def _leaf(spec: Composite, action_key: NestedKey) -> Any:
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
