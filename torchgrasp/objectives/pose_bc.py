"""Imitation: L_BC, with L_AUX off the same pass over the cloud."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams, dispatch
from tensordict.utils import NestedKey

from torchgrasp import keys
from torchgrasp.errors import check_range
from torchgrasp.objectives import functional
from torchgrasp.objectives.grasp_loss import Distance, GraspLoss, unique_keys


class PoseBCLoss(GraspLoss):
    """Writes `loss_bc`, the pose distance to the expert's action on samples that carry one.

    With `aux_weight` above 0, `loss_aux` as well: that weight times the distance of the actor's goal
    prediction to the goal on samples that carry one, at no further pass through the network.

    Args:
        actor_network: reads the state, writes the action (*, A) and, or not, a goal prediction.
        distance: between (*, A) actions, (*) per sample; L_POSE of Eq. (2) by default.
        aux_weight: of L_AUX. 0 switches it off.
        goal_distance: between (*, G) goals.
        reduction: 'mean' (over the samples that carry a label; None is the same), 'sum' or 'none'.
        use_prioritized_weights: whether weights of prioritised replay count; 'auto', where there are some.

    Example:
        >>> import torch
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> loss = PoseBCLoss(GraspActor(PointNet))
        >>> batch = TensorDict({"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1),
        ...                     "expert_action": torch.zeros(2, 6),
        ...                     "has_expert": torch.tensor([[True], [False]])}, [2])
        >>> loss(batch)["loss_bc"].backward()
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = keys.ACTION
        expert_action: NestedKey = keys.EXPERT_ACTION
        has_expert: NestedKey = keys.HAS_EXPERT
        goal_prediction: NestedKey = keys.GOAL_PREDICTION
        goal: NestedKey = keys.GOAL
        has_goal: NestedKey = keys.HAS_GOAL
        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys

    actor_network: TensorDictModuleBase
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: TensorDictModuleBase,
        *,
        distance: Distance = functional.action_distance,
        aux_weight: float = 0.0,
        goal_distance: Distance = functional.goal_distance,
        reduction: str | None = None,
        use_prioritized_weights: bool | Literal["auto"] = "auto",
    ) -> None:
        super().__init__(reduction=reduction, use_prioritized_weights=use_prioritized_weights)
        check_range("aux_weight", aux_weight, 0.0, float("inf"))
        self._adopt(actor_network, "actor_network")
        self.distance, self.aux_weight, self.goal_distance = distance, aux_weight, goal_distance

    @property
    def in_keys(self) -> list[NestedKey]:
        """Everything that is read; masks and weights may be missing."""
        names = ["expert_action", "has_expert"] + ["goal", "has_goal"] * (self.aux_weight > 0)
        return unique_keys(self.actor_network.in_keys, self._optional_keys(*names))

    def _terms(self) -> list[NestedKey]:
        return ["loss_bc", "loss_aux"] if self.aux_weight > 0 else ["loss_bc"]

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A batch to its losses: `loss_bc`, and `loss_aux` where it has a weight."""
        written = self._run(
            self.actor_network,
            self.actor_network_params,
            tensordict,
            predict_goal=self.aux_weight > 0,
        )
        bc = self._imitation_term(self._written(written, "action"), tensordict, self.distance)
        losses = {"loss_bc": bc}
        if self.aux_weight > 0:
            predicted = self._written(written, "goal_prediction", "set aux_weight=0")
            aux = self._goal_term(predicted, tensordict, self.goal_distance, success_only=False)
            losses["loss_aux"] = self.aux_weight * aux
        return TensorDict(losses, [])
