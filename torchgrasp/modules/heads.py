"""What actor and critic share: bounds of the action, encoders to order, goal heads (Sec. 6.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import GOAL_SIZE
from torchgrasp.modules.layers import mlp, shrink_last_layer

# An encoder, or what makes one for a number of input channels (in YAML: `_partial_: true`).
Encoder = nn.Module | Callable[[int], nn.Module]


def build_encoder(encoder: Encoder, in_channels: int) -> tuple[nn.Module, int]:
    """The encoder for clouds of `in_channels`, and the size of its feature, its `out_features`."""
    built = encoder if isinstance(encoder, nn.Module) else encoder(in_channels)
    size = getattr(built, "out_features", None)
    if not isinstance(size, int):
        raise ConfigError(
            f"encoder {type(built).__name__} has no integer attribute `out_features`: "
            "set it to the size of the feature that the encoder returns."
        )
    return built, size


def bound_tensor(action_bound: Sequence[float]) -> Tensor:
    """The largest magnitude of each action component as a (A,) float32 tensor, checked."""
    bound = torch.as_tensor(tuple(action_bound), dtype=torch.float32)
    if bound.ndim != 1 or len(bound) == 0 or not (bound > 0).all():
        raise ConfigError(
            f"action_bound={action_bound} must be a sequence of positive numbers, one a component."
        )
    return bound


def head(in_features: int, hidden: int, out_features: int) -> nn.Sequential:
    """Three fully connected layers with ReLU between them (Sec. 6.3)."""
    return mlp((in_features, hidden, hidden, out_features))


class GoalHead(nn.Module):
    """(*, F) features to the (*, 7) final grasp in the ee frame: metres, then a unit quaternion xyzw.

    The sign of the quaternion is free: q and -q are one rotation. At the start, every prediction is
    close to the ee's own pose.
    """

    def __init__(self, in_features: int, hidden: int) -> None:
        super().__init__()
        self.layers = head(in_features, hidden, GOAL_SIZE)
        shrink_last_layer(self.layers, 0.1)
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        last.bias.data[-1] = 1.0

    def forward(self, feature: Tensor) -> Tensor:
        """(*, F) features to (*, 7) goals."""
        goal = self.layers(feature)
        quaternion = nn.functional.normalize(goal[..., 3:], dim=-1, eps=1e-6)
        return torch.cat((goal[..., :3], quaternion), dim=-1)
