"""The actor: from cloud and time left to action and goal prediction (Sec. 6.3)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule
from tensordict.utils import NestedKey
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules.heads import Encoder, GoalHead, bound_tensor, build_encoder, head
from torchgrasp.modules.layers import shrink_last_layer


class GraspActor(TensorDictModule):
    """Reads a cloud (*, N, C) and time left (*, 1); writes the action (*, 6) and the goal (*, 7).

    The action is bounded by tanh: relative ee pose, metres and Euler angles; the goal is the final
    grasp in the ee frame, metres and unit quaternion xyzw.

    Args:
        encoder: module from (*, N, C) to (*, F) with an attribute `out_features`, or a callable
            that makes one from the number of channels.
        in_channels: C. The default is xyz and the flag of gripper points.
        action_bound: largest magnitude of each action component; its length is the action's size.
        hidden: width of the heads.
        vector_size: size of all vectors after the cloud in `in_keys` together.
        in_keys: the encoder's input, then vectors that join its feature. A goal-conditioned actor
            adds the goal here.
        out_keys: the action, then the goal; without the second there is no goal head.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import PointNet
        >>> actor = GraspActor(PointNet)
        >>> td = TensorDict({"points": torch.rand(2, 262, 4), "time_left": torch.ones(2, 1)}, [2])
        >>> actor(td)["action"].shape, td["goal_prediction"].shape
        (torch.Size([2, 6]), torch.Size([2, 7]))
    """

    def __init__(
        self,
        encoder: Encoder,
        *,
        in_channels: int = 4,
        action_bound: Sequence[float] = ACTION_BOUND,
        hidden: int = 256,
        vector_size: int = 1,
        in_keys: Sequence[NestedKey] = (keys.POINTS, keys.TIME_LEFT),
        out_keys: Sequence[NestedKey] = (keys.ACTION, keys.GOAL_PREDICTION),
    ) -> None:
        if len(out_keys) not in (1, 2):
            raise ConfigError(
                f"out_keys={list(out_keys)} must name the action and, or not, the goal prediction."
            )
        network = _ActorNetwork(
            encoder, in_channels, bound_tensor(action_bound), hidden, vector_size, has_goal=len(out_keys) == 2
        )
        super().__init__(network, in_keys=list(in_keys), out_keys=list(out_keys))


class _ActorNetwork(nn.Module):
    bound: Tensor

    def __init__(
        self,
        encoder: Encoder,
        in_channels: int,
        bound: Tensor,
        hidden: int,
        vector_size: int,
        *,
        has_goal: bool,
    ) -> None:
        super().__init__()
        self.encoder, size = build_encoder(encoder, in_channels)
        self.action_head = head(size + vector_size, hidden, len(bound))
        shrink_last_layer(self.action_head, 0.1)
        self.goal_head = GoalHead(size + vector_size, hidden) if has_goal else None
        self.register_buffer("bound", bound)

    def forward(self, points: Tensor, *vectors: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        feature = torch.cat((self.encoder(points), *vectors), dim=-1)
        action = self.bound * self.action_head(feature).tanh()
        return action if self.goal_head is None else (action, self.goal_head(feature))
