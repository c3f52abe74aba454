"""The actor: from cloud or image and time left to action and goal prediction (Sec. 6.3)."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict.utils import NestedKey
from torch import Tensor, nn

from torchgrasp import keys
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
    head,
)
from torchgrasp.modules.layers import shrink_last_layer
from torchgrasp.modules.network import GraspNetwork


class GraspActor(GraspNetwork):
    """Reads a cloud (*, N, C) and time left (*, 1); writes the action (*, 6) and the goal (*, 7).

    The action is bounded by tanh: relative ee pose, metres and Euler angles; the goal is the final
    grasp in the ee frame, metres and unit quaternion xyzw. `goal_input` and `goal_prediction` are the
    actor's part of Table 2. ``actor(td, predict_goal=False)`` computes the action alone.

    Args:
        encoder: module from (*, N, C) clouds or (*, C, H, W) images to (*, F) with an attribute
            `out_features`, or a callable that makes one from the number of channels.
        in_channels: C. The default is xyz and the flag of gripper points.
        action_bound: largest magnitude of each action component; its length is the action's size.
        hidden: width of the heads.
        goal_input: also read the goal (*, 7) of `goal_key`, which joins the feature as time left does;
            zeros say that there is none.
        table_input: also read the table's plane (*, 4) of `table_key`: it joins the feature, and each point's
            height above it is one more channel of a cloud. Not in the paper.
        state_inputs: {key: size} of further observations (*, size) that join the feature as time left does,
            such as ``{"wrist_angle": 1}`` (`WristAngle`). Not in the paper.
        goal_prediction: whether the actor predicts the goal.
        freeze_encoder: keep the encoder as it is (Sec. 6.3: fine-tuning with hindsight goals). A module
            is copied, so that freezing stays here.
        in_keys: the encoder's input and time left.
        goal_key: what `goal_input` adds to `in_keys`.
        table_key: what `table_input` adds to `in_keys`, after all others.
        out_keys: the action, then the goal prediction where there is one.

    Example:
        >>> import torch
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
        goal_input: bool = False,
        table_input: bool = False,
        state_inputs: StateInputs | None = None,
        goal_prediction: bool = True,
        freeze_encoder: bool = False,
        in_keys: Sequence[NestedKey] = (keys.POINTS, keys.TIME_LEFT),
        goal_key: NestedKey = keys.GOAL,
        table_key: NestedKey = keys.TABLE_PLANE,
        out_keys: Sequence[NestedKey] = (keys.ACTION, keys.GOAL_PREDICTION),
    ) -> None:
        read = check_keys("in_keys", in_keys, ("the encoder's input", "time left"))
        written = choose_out_keys(out_keys, "the action", predicts_goal=goal_prediction)
        further = check_inputs(state_inputs)
        built, size = build_encoder(encoder, in_channels, freeze=freeze_encoder, heights=table_input)
        network = _ActorNetwork(
            built,
            size + 1 + goal_input * GOAL_SIZE + sum(further.values()) + table_input * PLANE_SIZE,
            bound_tensor(action_bound),
            hidden,
            predicts_goal=goal_prediction,
            freeze=freeze_encoder,
            reads_table=table_input,
        )
        network.limits = tuple(map(float, action_bound))
        super().__init__(
            network,
            in_keys=[*read, *[as_key(goal_key)] * goal_input, *further, *[as_key(table_key)] * table_input],
            out_keys=written,
        )


class _ActorNetwork(EncoderNetwork):
    bound: Tensor
    limits: tuple[float, ...]  # the bound as numbers, which a network on the meta device has too

    def __init__(
        self,
        encoder: nn.Module,
        feature_size: int,
        bound: Tensor,
        hidden: int,
        *,
        predicts_goal: bool,
        freeze: bool,
        reads_table: bool,
    ) -> None:
        super().__init__(encoder, freeze=freeze, reads_table=reads_table)
        self.action_head = head(feature_size, hidden, len(bound))
        shrink_last_layer(self.action_head, 0.1)
        self.goal_head = GoalHead(feature_size, hidden) if predicts_goal else None
        self.register_buffer("bound", bound)

    def forward(
        self, observed: Tensor, *vectors: Tensor, predict_goal: bool = True
    ) -> Tensor | tuple[Tensor, Tensor]:
        feature = self.encode(observed, *vectors, dtype=self.bound.dtype)
        action = self.bound * self.action_head(feature).tanh()
        if self.goal_head is None or not predict_goal:
            return action
        return action, self.goal_head(feature)
