"""The goal network: grasp prediction alone, in front of goal-conditioned policies (Sec. 6.5, Table 5)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.modules.heads import (
    PLANE_SIZE,
    Encoder,
    EncoderNetwork,
    GoalHead,
    StateInputs,
    as_key,
    build_encoder,
    check_inputs,
    check_keys,
)
from torchgrasp.modules.network import GraspNetwork


class GoalPredictor(GraspNetwork):
    """Reads a cloud (*, N, C) and time left (*, 1); writes the goal (*, 7) that others read.

    The goal is the final grasp in the ee frame, metres and unit quaternion xyzw with w >= 0, as the
    expert's label has it. GoalAuxLoss trains it, with ``set_keys(goal_prediction="goal")``; at
    evaluation it goes before the actor: ``TensorDictSequential(predictor, actor)``.

    Args:
        encoder: as for GraspActor.
        in_channels: C.
        hidden: width of the head.
        table_input: also read the table's plane, as GraspActor does.
        state_inputs: further observations, as GraspActor reads them.
        in_keys: the encoder's input and time left.
        goal_key: what is written.
        table_key: what `table_input` adds to `in_keys`, after all others.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictSequential
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> policy = TensorDictSequential(GoalPredictor(PointNet), GraspActor(PointNet, goal_input=True))
        >>> td = TensorDict({"points": torch.rand(2, 262, 4), "time_left": torch.ones(2, 1)}, [2])
        >>> policy(td)["goal"].shape, td["action"].shape
        (torch.Size([2, 7]), torch.Size([2, 6]))
    """

    def __init__(
        self,
        encoder: Encoder,
        *,
        in_channels: int = 4,
        hidden: int = 256,
        table_input: bool = False,
        state_inputs: StateInputs | None = None,
        in_keys: Sequence[NestedKey] = (keys.POINTS, keys.TIME_LEFT),
        goal_key: NestedKey = keys.GOAL,
        table_key: NestedKey = keys.TABLE_PLANE,
    ) -> None:
        read = check_keys("in_keys", in_keys, ("the encoder's input", "time left"))
        further = check_inputs(state_inputs)
        built, size = build_encoder(encoder, in_channels, heights=table_input)
        size += 1 + sum(further.values()) + table_input * PLANE_SIZE
        network = _GoalNetwork(built, size, hidden, reads_table=table_input)
        read += [*further, *[as_key(table_key)] * table_input]
        super().__init__(network, in_keys=read, out_keys=[as_key(goal_key)])


class _GoalNetwork(EncoderNetwork):
    def __init__(self, encoder: nn.Module, feature_size: int, hidden: int, *, reads_table: bool) -> None:
        super().__init__(encoder, reads_table=reads_table)
        self.goal_head = GoalHead(feature_size, hidden)

    def forward(self, observed: Tensor, *vectors: Tensor) -> Tensor:
        feature = self.encode(observed, *vectors, dtype=self.goal_head.dtype)
        goal = self.goal_head(feature)
        # q and -q are one rotation, but not one input: the labels that actors learn from have w >= 0.
        quaternion = torch.where(goal[..., -1:] < 0, -goal[..., 3:], goal[..., 3:])
        return torch.cat((goal[..., :3], quaternion), dim=-1)
