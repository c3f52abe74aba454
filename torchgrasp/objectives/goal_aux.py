"""The auxiliary task: L_AUX, predicting the final grasp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams, dispatch
from tensordict.utils import NestedKey

from torchgrasp import keys
from torchgrasp.objectives import functional
from torchgrasp.objectives.grasp_loss import Distance, GraspLoss, unique_keys


class GoalAuxLoss(GraspLoss):
    """Writes `loss_aux`, the pose distance of the goal prediction to the goal where there is one.

    Args:
        network: any module that writes a goal prediction (*, 7): an actor or a critic.
        distance: between (*, 7) goals, (*) per sample; L_POSE of Eq. (2) by default.
        success_only: multiply each sample by its episode's success, r_T of Eq. (5).
        reduction: 'mean' (over the samples that carry a goal; None is the same), 'sum' or 'none'.
        use_prioritized_weights: whether weights of prioritised replay count; 'auto', where there are some.

    Example:
        >>> import torch
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> loss = GoalAuxLoss(GraspActor(PointNet))
        >>> goal = torch.tensor([[0.0, 0, 0.1, 0, 0, 0, 1]])
        >>> loss(points=torch.rand(1, 64, 4), time_left=torch.ones(1, 1), goal=goal).backward()
    """

    @dataclass
    class _AcceptedKeys:
        goal_prediction: NestedKey = keys.GOAL_PREDICTION
        goal: NestedKey = keys.GOAL
        has_goal: NestedKey = keys.HAS_GOAL
        episode_success: NestedKey = keys.EPISODE_SUCCESS
        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys

    network: TensorDictModuleBase
    network_params: TensorDictParams
    target_network_params: TensorDictParams

    def __init__(
        self,
        network: TensorDictModuleBase,
        *,
        distance: Distance = functional.goal_distance,
        success_only: bool = False,
        reduction: str | None = None,
        use_prioritized_weights: bool | Literal["auto"] = "auto",
    ) -> None:
        super().__init__(reduction=reduction, use_prioritized_weights=use_prioritized_weights)
        self._adopt(network, "network")
        self.distance, self.success_only = distance, success_only

    @property
    def in_keys(self) -> list[NestedKey]:
        """Everything that is read; masks and weights may be missing."""
        names = ["goal", "has_goal"] + ["episode_success"] * self.success_only
        return unique_keys(self.network.in_keys, self._optional_keys(*names))

    def _terms(self) -> list[NestedKey]:
        return ["loss_aux"]

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A batch to `loss_aux`."""
        written = self._run(self.network, self.network_params, tensordict)
        predicted = self._written(written, "goal_prediction")
        loss = self._goal_term(predicted, tensordict, self.distance, success_only=self.success_only)
        return TensorDict({"loss_aux": loss}, [])
