"""Target policy smoothing of TD3 (Fujimoto et al. 2018), within the action's limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.data import Bounded

from torchgrasp.errors import ConfigError, check_range


class TargetSmoothing(nn.Module):
    """Adds clipped normal noise to actions (*, A) and clips them to their limits.

    Args:
        policy_noise: standard deviation, in units of each component's half range.
        noise_clip: largest magnitude of the noise, in the same units.
        action_bound: largest magnitude of each component.
        action_spec: a Bounded spec that gives the limits instead.
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
        action_bound: Sequence[float],
        action_spec: Bounded | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        check_range("policy_noise", policy_noise, 0.0, float("inf"))
        check_range("noise_clip", noise_clip, 0.0, float("inf"))
        self.policy_noise, self.noise_clip, self.generator = policy_noise, noise_clip, generator
        low, high = _limits(action_bound, action_spec)
        self.register_buffer("low", low)
        self.register_buffer("high", high)

    def forward(self, action: Tensor) -> Tensor:
        """(*, A) actions to noisy ones within the limits."""
        if self.low.numel() != action.shape[-1]:
            raise ConfigError(
                f"the limits have {self.low.numel()} components and the action {action.shape[-1]}: "
                "give action_bound or action_spec of the action's size."
            )
        if self.policy_noise == 0:
            return action.clamp(self.low, self.high)
        noise = torch.randn(action.shape, generator=self.generator, dtype=action.dtype, device=action.device)
        noise = (self.policy_noise * noise).clamp(-self.noise_clip, self.noise_clip)
        return (action + noise * (self.high - self.low) / 2).clamp(self.low, self.high)


def _limits(action_bound: Sequence[float], action_spec: Any) -> tuple[Tensor, Tensor]:
    """Low and high of one action, (A,) each."""
    if action_spec is None:
        bound = torch.as_tensor(tuple(action_bound), dtype=torch.float32)
        if not (bound > 0).all():
            raise ConfigError(f"action_bound={action_bound} must be positive numbers, one a component.")
        return -bound, bound
    if not isinstance(action_spec, Bounded):
        raise ConfigError(f"action_spec={action_spec} has no limits: give a Bounded spec, or action_bound.")
    space: Any = action_spec.space
    size = action_spec.shape[-1]
    return space.low.reshape(-1, size)[0].clone(), space.high.reshape(-1, size)[0].clone()
