"""Actor and critic together: TD3+BC with goal-auxiliary losses (Sec. 3.4, Eq. (3) to (5))."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch.optim import Optimizer

from torchgrasp.errors import check_whole
from torchgrasp.modules.mirrored_policy import Mirror
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.training.acceleration import Acceleration
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
        acceleration: how updates are run; as they are by default.
        mirror: as for every ImitationLearner.
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
        acceleration: Acceleration | None = None,
        mirror: Mirror | None = None,
    ) -> None:
        check_whole("policy_delay", policy_delay, 1)
        self.loss, self.targets, self.policy_delay = loss, targets, policy_delay
        self.critic_updates = 0
        super().__init__(
            networks,
            imitation=imitation,
            optimizers=optimizers,
            grasp_prediction=grasp_prediction,
            acceleration=acceleration,
            mirror=mirror,
        )

    def _wrap_updates(self) -> None:
        super()._wrap_updates()
        noise = self.loss.smoothing.generator
        generators = () if noise is None else (noise,)
        self._critic_update = self.acceleration.wrap(self._learn_values, generators)
        self._actor_update = self.acceleration.wrap(self._improve)

    @property
    def actor_is_due(self) -> bool:
        """Whether the critic has been updated often enough for the next update of the actor."""
        return self.critic_updates > 0 and self.critic_updates % self.policy_delay == 0

    def copy_to_targets(self) -> None:
        """Copy all parameters into the targets, which then know what imitation has taught."""
        self.targets.copy()

    def update_critic(self, batch: TensorDictBase) -> None:
        """One update after Eq. (3) on a batch (B), which gets a `td_error`, and the targets' step."""
        out = self._critic_update(batch)
        batch.set(self._error_key, out.get("errors"))
        self._note(out.exclude("errors"))
        self.targets.count()
        self.critic_updates += 1

    def update_actor(self, batch: TensorDictBase) -> None:
        """One update after Eq. (4) on a batch (B), and one of the goal network where there is one."""
        self._note(self._actor_update(batch))

    @property
    def _error_key(self) -> Any:
        """Where the critic's loss writes its errors."""
        accepted: Any = self.loss.tensor_keys
        return accepted.priority

    def _learn_values(self, batch: TensorDictBase) -> TensorDictBase:
        """The terms of the critic, and the `errors` (B) that its loss writes into the batch."""
        terms = self._descend("critic", self.loss.critic_loss(batch))
        self.targets.follow()
        return TensorDict({"critic": terms, "errors": batch.get(self._error_key)})

    def _improve(self, batch: TensorDictBase) -> TensorDictBase:
        terms = self._descend("actor", self.loss.actor_loss(batch))
        return TensorDict({"actor": terms, **self._predict_grasps(batch)})

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimizers, targets and the count of critic updates."""
        return {
            **super().state_dict(),
            "loss": self.loss.state_dict(),
            "targets": self.targets.state_dict(),
            "critic_updates": self.critic_updates,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take up what `state_dict` gave; KeyError, RuntimeError or ValueError where it is of others."""
        self.loss.load_state_dict(state["loss"])
        self.targets.load_state_dict(state["targets"])
        super().load_state_dict(state)
        self.critic_updates = state["critic_updates"]
