"""Actor and critic together: TD3+BC with goal-auxiliary losses (Sec. 3.4, Eq. (3) to (5))."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch.optim import Optimizer

from torchgrasp.errors import check_whole
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.training.imitation import ImitationLearner


class ActorCriticLearner(ImitationLearner):
    """An ImitationLearner with a critic, the losses of Eq. (3) to (5), and target networks.

    The actor is due after every `policy_delay` critic updates, counted over the whole run and saved with it.

    Args:
        networks: by name: `actor`, `critic`, with `goal_network` where the actor reads goals.
        loss: of actor and critic.
        targets: of the loss.
        imitation: of the actor alone.
        optimizers: one for each network, under its name.
        policy_delay: critic updates an actor update (Sec. 6.4: 2).
        grasp_prediction: of the goal network, where there is one.
    """

    def __init__(
        self,
        networks: Mapping[str, TensorDictModuleBase],
        *,
        loss: GraspTD3BCLoss,
        targets: StaggeredTargetUpdate,
        imitation: PoseBCLoss,
        optimizers: Mapping[str, Optimizer],
        policy_delay: int = 2,
        grasp_prediction: GoalAuxLoss | None = None,
    ) -> None:
        super().__init__(
            networks, imitation=imitation, optimizers=optimizers, grasp_prediction=grasp_prediction
        )
        check_whole("policy_delay", policy_delay, 1)
        self.loss, self.targets, self.policy_delay = loss, targets, policy_delay
        self.critic_updates = 0

    @property
    def actor_is_due(self) -> bool:
        """Whether the critic has been updated often enough for the next update of the actor."""
        return self.critic_updates > 0 and self.critic_updates % self.policy_delay == 0

    def copy_to_targets(self) -> None:
        """Copy all parameters into the targets, which then know what imitation has taught."""
        self.targets.copy()

    def update_critic(self, batch: TensorDictBase) -> None:
        """One update after Eq. (3) on a batch (B), which gets a `td_error`, and the targets' step."""
        self._descend("critic", self.loss.critic_loss(batch))
        self.targets.step()
        self.critic_updates += 1

    def update_actor(self, batch: TensorDictBase) -> None:
        """One update after Eq. (4) on a batch (B), and one of the goal network where there is one."""
        self._descend("actor", self.loss.actor_loss(batch))
        self._update_goal_network(batch)

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimizers, targets and the count of critic updates."""
        return {
            **super().state_dict(),
            "loss": self.loss.state_dict(),
            "targets": self.targets.state_dict(),
            "critic_updates": self.critic_updates,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take up what `state_dict` gave; KeyError or RuntimeError where it is of other networks."""
        self.loss.load_state_dict(state["loss"])
        self.targets.load_state_dict(state["targets"])
        super().load_state_dict(state)
        self.critic_updates = state["critic_updates"]
