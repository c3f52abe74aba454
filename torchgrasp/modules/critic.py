"""The critic: Q-values side by side off one pass over the cloud, and a goal prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from tensordict.nn import TensorDictModule
from tensordict.utils import NestedKey
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules.heads import Encoder, GoalHead, bound_tensor, build_encoder, head


class GraspCritic(TensorDictModule):
    """Reads a cloud (*, N, C), time left (*, 1) and action (*, A); writes (*, num_q) values, (*, 7) goal.

    Early fusion, the paper's choice, writes the action beside every point's features, so that the
    encoder sees what the action does to the cloud; late fusion joins it to the cloud's feature
    (an ablation, and worse). Actions are divided by their bounds first. Q-values are not squashed.

    In TorchRL's own losses set ``deactivate_vmap=True``: the encoders choose rows by their values,
    which vmap cannot follow.

    Args:
        encoder: as for GraspActor, of C + A channels under early fusion, else of C.
        in_channels: C, without the action.
        num_q: how many values, each from its own head of three layers.
        fusion: 'early' or 'late'.
        action_bound: largest magnitude of each action component; its length is A.
        hidden: width of the heads.
        vector_size: size of all vectors between the cloud and the action in `in_keys` together.
        in_keys: the encoder's input, vectors that join its feature, and last the action.
        out_keys: the values, then the goal; without the second there is no goal head.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import PointNet
        >>> critic = GraspCritic(PointNet)
        >>> td = TensorDict({"points": torch.rand(2, 262, 4), "time_left": torch.ones(2, 1),
        ...                  "action": torch.zeros(2, 6)}, [2])
        >>> critic(td)["state_action_value"].shape
        torch.Size([2, 2])
    """

    def __init__(
        self,
        encoder: Encoder,
        *,
        in_channels: int = 4,
        num_q: int = 2,
        fusion: Literal["early", "late"] = "early",
        action_bound: Sequence[float] = ACTION_BOUND,
        hidden: int = 256,
        vector_size: int = 1,
        in_keys: Sequence[NestedKey] = (keys.POINTS, keys.TIME_LEFT, keys.ACTION),
        out_keys: Sequence[NestedKey] = (keys.STATE_ACTION_VALUE, keys.GOAL_PREDICTION),
    ) -> None:
        if fusion not in ("early", "late"):
            raise ConfigError(f"fusion={fusion!r} is unknown: choose 'early' or 'late'.")
        if num_q < 1:
            raise ConfigError(f"num_q={num_q}: a critic needs at least one value; TD3 takes 2.")
        if len(out_keys) not in (1, 2):
            raise ConfigError(
                f"out_keys={list(out_keys)} must name the values and, or not, the goal prediction."
            )
        bound = bound_tensor(action_bound)
        early = fusion == "early"
        built, size = build_encoder(encoder, in_channels + early * len(bound))
        size += vector_size + (not early) * len(bound)
        network = _CriticNetwork(built, size, bound, hidden, num_q, early=early, has_goal=len(out_keys) == 2)
        super().__init__(network, in_keys=list(in_keys), out_keys=list(out_keys))


class _CriticNetwork(nn.Module):
    bound: Tensor

    def __init__(
        self,
        encoder: nn.Module,
        feature_size: int,
        bound: Tensor,
        hidden: int,
        num_q: int,
        *,
        early: bool,
        has_goal: bool,
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.early = early
        self.value_heads = nn.ModuleList(head(feature_size, hidden, 1) for _ in range(num_q))
        self.goal_head = GoalHead(feature_size, hidden) if has_goal else None
        self.register_buffer("bound", bound)

    def forward(self, points: Tensor, *vectors: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        action, vectors = vectors[-1] / self.bound, vectors[:-1]
        if self.early:
            tiled = action[..., None, :].expand(*points.shape[:-1], -1)
            feature = torch.cat((self.encoder(torch.cat((points, tiled), dim=-1)), *vectors), dim=-1)
        else:
            feature = torch.cat((self.encoder(points), *vectors, action), dim=-1)
        values = torch.cat([value_head(feature) for value_head in self.value_heads], dim=-1)
        return values if self.goal_head is None else (values, self.goal_head(feature))
