"""Actor and critic together: what td3_bc and hindsight train."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydra.utils import instantiate
from imitator import Imitator
from omegaconf import DictConfig
from tensordict import TensorDictBase

from torchgrasp.objectives import StaggeredTargetUpdate


class Learner(Imitator):
    """An Imitator with a critic, the losses of Eq. (3) to (5) and target networks.

    Args:
        cfg: the recipe's configuration.
        shapes: of the observations, as `common.observed_shapes` tells them.
        own: name of the source that the run's episodes are added to.
    """

    def __init__(
        self, cfg: DictConfig, shapes: Mapping[Any, tuple[int, ...]], *, own: str = "online"
    ) -> None:
        super().__init__(cfg, shapes, critic=True, own=own)

    def _make_losses(self) -> None:
        cfg, self.critic = self.cfg, self.networks["critic"]
        self.loss = instantiate(cfg.loss, self.actor, self.critic).to(cfg.device)
        self.loss.make_value_estimator(gamma=cfg.online.gamma)
        self.targets = StaggeredTargetUpdate(self.loss, tau=cfg.online.tau, period=cfg.online.period)
        super()._make_losses()

    def _distances(self) -> tuple[Any, Any]:
        return self.loss.distance, self.loss.goal_distance

    def begin_reinforcement(self) -> None:
        """Draw from all sources, with targets that know what imitation has taught."""
        self.experience.draw_all()
        if self.iterations == 0:
            self.targets.copy()

    def pretrain(self, batch: TensorDictBase) -> dict[str, float]:
        """One update of imitation, and one of the critic where configured."""
        metrics = super().pretrain(batch)
        return metrics | self._learn_values(batch) if self.cfg.pretrain.critic else metrics

    def reinforce(self) -> dict[str, float]:
        """The updates of an iteration: the critic's, and one of the actor every `online.policy_delay`.

        During the first `online.critic_warmup` iterations the critic learns alone.
        """
        metrics: dict[str, float] = {}
        actor_learns = self.iterations >= self.cfg.online.critic_warmup
        for update in range(1, self.updates_ahead + 1):
            batch = self.experience.sample()
            metrics |= self.update_critic(batch)
            if actor_learns and update % self.cfg.online.policy_delay == 0:
                metrics |= self.update_actor(batch)
        return metrics

    def update_critic(self, batch: TensorDictBase) -> dict[str, float]:
        """One update after Eq. (3), and the targets' step."""
        self.gradient_steps += 1
        return self._learn_values(batch)

    def _learn_values(self, batch: TensorDictBase) -> dict[str, float]:
        metrics = self._descend("critic", self.loss.critic_loss(batch))
        self.buffer.update_tensordict_priority(batch)
        self.targets.step()
        return metrics

    def update_actor(self, batch: TensorDictBase) -> dict[str, float]:
        """One update after Eq. (4), and one of the goal network where there is one."""
        return self._descend("actor", self.loss.actor_loss(batch)) | self._update_goal_network(batch)

    def _state(self) -> dict[str, Any]:
        state = super()._state()
        return {**state, "loss": self.loss.state_dict(), "targets": self.targets.state_dict()}

    def _take_up(self, state: dict) -> None:
        self.loss.load_state_dict(state["loss"])
        self.targets.load_state_dict(state["targets"])
        super()._take_up(state)
