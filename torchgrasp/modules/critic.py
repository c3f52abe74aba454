"""The critic: Q-values side by side off one pass over the cloud or image, and a goal prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND, GOAL_SIZE
from torchgrasp.modules.heads import (
    PLANE_SIZE,
    Encoder,
    EncoderNetwork,
    GoalHead,
    StateInputs,
    as_key,
    bound_tensor,
    build_encoder,
    check_inputs,
    check_keys,
    choose_out_keys,
    get_channel_dim,
    head,
    join_channels,
)
from torchgrasp.modules.layers import Norm
from torchgrasp.modules.network import GraspNetwork


class GraspCritic(GraspNetwork):
    """Reads a cloud (*, N, C), time left (*, 1) and action (*, A); writes (*, num_q) values, (*, 7) goal.

    Early fusion, the paper's choice, writes the action beside every point's features, or as constant
    channels of an image, so that the encoder sees what the action does to the cloud; late fusion joins
    it to the cloud's feature (an ablation, and worse). Actions are divided by their bounds first.
    Q-values are not squashed. `goal_input` and `goal_prediction` are the critic's part of Table 2.
    ``critic(td, predict_goal=False, values=slice(0, 1))`` computes the first value alone.

    TorchRL's own losses take it, by vmap as well; ``deactivate_vmap=True`` is faster there, because under
    vmap every row of a cloud carries a graph.

    Args:
        encoder: as for GraspActor, of C + A channels under early fusion, else of C.
        in_channels: C, without the action.
        num_q: how many values, each from its own head of three layers.
        fusion: 'early' or 'late'.
        action_bound: largest magnitude of each action component; its length is A.
        hidden: width of the heads.
        norm: of the hidden layers of the values' heads; 'layer' keeps values of actions that no data
            hold within bounds (Ball et al. 2023, arXiv 2302.02948). Not in the paper.
        goal_input: also read the goal (*, 7) of `goal_key`, which joins the feature as time left does.
        table_input: also read the table's plane, as GraspActor does.
        state_inputs: further observations, as GraspActor reads them.
        goal_prediction: whether the critic predicts the goal.
        freeze_encoder: keep the encoder as it is; under early fusion gradients still pass through it
            to the action. A module is copied, as for GraspActor.
        in_keys: the encoder's input, time left and the action.
        goal_key: what `goal_input` adds to `in_keys`, before the action.
        table_key: what `table_input` adds, after `state_inputs`.
        out_keys: the values, then the goal prediction where there is one.

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
        norm: Norm = "none",
        goal_input: bool = False,
        table_input: bool = False,
        state_inputs: StateInputs | None = None,
        goal_prediction: bool = True,
        freeze_encoder: bool = False,
        in_keys: Sequence[NestedKey] = (keys.POINTS, keys.TIME_LEFT, keys.ACTION),
        goal_key: NestedKey = keys.GOAL,
        table_key: NestedKey = keys.TABLE_PLANE,
        out_keys: Sequence[NestedKey] = (keys.STATE_ACTION_VALUE, keys.GOAL_PREDICTION),
    ) -> None:
        if fusion not in ("early", "late"):
            raise ConfigError(f"fusion={fusion!r} is unknown: choose 'early' or 'late'.")
        if num_q < 1:
            raise ConfigError(f"num_q={num_q}: a critic needs at least one value; TD3 takes 2.")
        *state, action = check_keys("in_keys", in_keys, ("the encoder's input", "time left", "the action"))
        written = choose_out_keys(out_keys, "the values", predicts_goal=goal_prediction)
        bound = bound_tensor(action_bound)
        early, further = fusion == "early", check_inputs(state_inputs)
        channels = in_channels + early * len(bound)
        built, size = build_encoder(encoder, channels, freeze=freeze_encoder, heights=table_input)
        size += 1 + goal_input * GOAL_SIZE + sum(further.values()) + table_input * PLANE_SIZE
        size += (not early) * len(bound)
        network = _CriticNetwork(
            built,
            size,
            bound,
            hidden,
            num_q,
            norm=norm,
            early=early,
            predicts_goal=goal_prediction,
            freeze=freeze_encoder,
            reads_table=table_input,
        )
        goal, table = [as_key(goal_key)] * goal_input, [as_key(table_key)] * table_input
        super().__init__(
            network,
            in_keys=[*state, *goal, *further, *table, action],
            out_keys=written,
        )


class _CriticNetwork(EncoderNetwork):
    bound: Tensor
    reads_action = True

    def __init__(
        self,
        encoder: nn.Module,
        feature_size: int,
        bound: Tensor,
        hidden: int,
        num_q: int,
        *,
        norm: Norm,
        early: bool,
        predicts_goal: bool,
        freeze: bool,
        reads_table: bool,
    ) -> None:
        super().__init__(encoder, freeze=freeze, reads_table=reads_table)
        dim = get_channel_dim(encoder)
        if early and dim is None:
            raise ConfigError("fusion='early' needs a cloud or an image; features take fusion='late'.")
        self.reads_action_early, self.channel_dim = early, dim or -1
        self.value_heads = nn.ModuleList(head(feature_size, hidden, 1, norm=norm) for _ in range(num_q))
        self.goal_head = GoalHead(feature_size, hidden) if predicts_goal else None
        self.register_buffer("bound", bound)

    def forward(
        self,
        observed: Tensor,
        *vectors: Tensor,
        predict_goal: bool = True,
        values: slice = slice(None),
    ) -> Tensor | tuple[Tensor, Tensor]:
        action, vectors = vectors[-1] / self.bound, vectors[:-1]
        if self.reads_action_early:
            observed = join_channels(observed, action, self.channel_dim)
        else:
            vectors = (action, *vectors)
        feature = self.encode(observed, *vectors, dtype=self.bound.dtype)
        found = torch.cat([value_head(feature) for value_head in list(self.value_heads)[values]], dim=-1)
        if self.goal_head is None or not predict_goal:
            return found
        return found, self.goal_head(feature)
