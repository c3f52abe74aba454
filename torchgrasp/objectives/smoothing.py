"""Target policy smoothing of TD3 (Fujimoto et al. 2018), within the action's limits."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import TensorSpec

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.modules.action_limits import find_limits


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
        low, high = find_limits(action_bound, action_spec, action_key)
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
