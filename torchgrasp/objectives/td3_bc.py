"""Reinforcement, imitation and goal prediction together: Eq. (3), (4) and (5)."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams, dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import TensorSpec

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.objectives import functional
from torchgrasp.objectives.bootstrapped_loss import BootstrappedLoss
from torchgrasp.objectives.grasp_loss import Distance, unique_keys
from torchgrasp.objectives.side_by_side import SideBySide
from torchgrasp.objectives.smoothing import TargetSmoothing


class GraspTD3BCLoss(BootstrappedLoss):
    """TD3 with imitation and goal prediction; its terms sum to Eq. (3) and Eq. (4), weights included.

    Critic: `loss_qvalue` = sum over heads of 1/2 (Q - y)^2, where no disturbance moved the arm, and
    `loss_critic_aux` = aux_weight L_AUX. Actor: `loss_actor_bc` = λ L_BC,
    `loss_actor_ddpg` = (1 - λ) (-Q1(s, π(s))) and `loss_actor_aux` = aux_weight L_AUX; their gradients
    stop at the critic's parameters. `critic_loss` and `actor_loss` compute one side each, for actor
    updates that come every second time; `forward` computes both. Terms of weight 0, and goal terms of
    networks without a goal prediction, are absent from the output.

    The discount is 0.95 until ``make_value_estimator(gamma=...)``, to the power of `steps_to_next_obs` where
    a batch has it; like the limits of the action it is configuration and no part of the state_dict. The
    batch's td error is written under the priority key, and where a term leaves a sample out, the mean of
    those that count.

    Passes of target networks, and of the critic for the actor, take BatchNorm's stored statistics and
    leave them as they are.

    Args:
        actor_network: reads the state, writes the action (*, A) and, or not, a goal prediction.
        critic_network: reads state and action, writes values side by side (*, Q) and, or not, a goal
            prediction. Or a list of critics, which keep their weights.
        bc_weight: λ in [0, 1]. 0 needs no expert; 1 is imitation, and the critic is not asked.
        aux_weight: of L_AUX on either side.
        distance: between (*, A) actions, (*) per sample; L_POSE of Eq. (2) by default.
        goal_distance: between (*, G) goals.
        hindsight: multiply L_AUX by the episode's success (Eq. 5).
        policy_noise: standard deviation of the target action's noise, in units of the action's half
            range; 0 and one value make it DDPG.
        noise_clip: largest magnitude of that noise, in the same units.
        action_bound: largest magnitude of each action component, to which target actions are clipped.
        action_spec: instead of it, the action's Bounded spec, or a Composite that holds it: of an
            environment, or of TorchRL's Actor.
        value_limits: least and largest value that is possible, (0, 1) of an episode that ends with a success
            or without; targets are clipped to them. None clips nothing. Not in the paper.
        staggered_targets: keep a second set of target parameters for the values after the first, for
            StaggeredTargetUpdate; without it one pass gives all target values. A list of critics
            needs no second set.
        reduction: 'mean' (over the samples that a term counts; None is the same), 'sum' or 'none'.
        use_prioritized_weights: whether weights of prioritised replay count; 'auto', where there are some.
        generator: of the target noise; torch's own without one.

    Example:
        >>> from torchgrasp.modules import GraspActor, GraspCritic, PointNet
        >>> from torchgrasp.geometry import ACTION_BOUND
        >>> from torchgrasp.objectives import StaggeredTargetUpdate
        >>> networks = GraspActor(PointNet), GraspCritic(PointNet)
        >>> loss = GraspTD3BCLoss(*networks, bc_weight=0.0, action_bound=ACTION_BOUND)
        >>> updater = StaggeredTargetUpdate(loss)
        >>> state = {"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}
        >>> ends = {"reward": torch.ones(2, 1), "terminated": torch.ones(2, 1, dtype=torch.bool)}
        >>> goal = torch.tensor([[0.0, 0, 0.1, 0, 0, 0, 1]]).expand(2, 7)
        >>> batch = TensorDict({**state, "action": torch.zeros(2, 6), "goal": goal,
        ...                     "next": {**state, **ends}}, [2])
        >>> sorted(key for key in loss(batch).keys() if key.startswith("loss_actor"))
        ['loss_actor_aux', 'loss_actor_ddpg']
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = keys.ACTION
        state_action_value: NestedKey = keys.STATE_ACTION_VALUE
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        terminated: NestedKey = "terminated"
        steps_to_next_obs: NestedKey = "steps_to_next_obs"
        expert_action: NestedKey = keys.EXPERT_ACTION
        has_expert: NestedKey = keys.HAS_EXPERT
        goal_prediction: NestedKey = keys.GOAL_PREDICTION
        goal: NestedKey = keys.GOAL
        has_goal: NestedKey = keys.HAS_GOAL
        perturbed: NestedKey = keys.PERTURBED
        episode_success: NestedKey = keys.EPISODE_SUCCESS
        priority: NestedKey = "td_error"
        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys

    actor_network: TensorDictModuleBase
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    critic_network: TensorDictModuleBase
    critic_network_params: TensorDictParams
    target_critic_network_params: TensorDictParams
    target_delayed_critic_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: TensorDictModuleBase,
        critic_network: TensorDictModuleBase | Sequence[TensorDictModuleBase],
        *,
        bc_weight: float = 0.2,
        aux_weight: float = 1.0,
        distance: Distance = functional.action_distance,
        goal_distance: Distance = functional.goal_distance,
        hindsight: bool = False,
        policy_noise: float = 0.2,
        noise_clip: float = 0.5,
        action_bound: Sequence[float] | None = None,
        action_spec: TensorSpec | None = None,
        value_limits: Sequence[float] | None = None,
        staggered_targets: bool = True,
        reduction: str | None = None,
        use_prioritized_weights: bool | Literal["auto"] = "auto",
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(
            value_limits=value_limits, reduction=reduction, use_prioritized_weights=use_prioritized_weights
        )
        check_range("bc_weight", bc_weight, 0.0, 1.0)
        check_range("aux_weight", aux_weight, 0.0, float("inf"))
        if not isinstance(hindsight, bool):
            raise ConfigError(f"hindsight={hindsight}: give True or False.")
        self._adopt_networks(actor_network, critic_network, staggered_targets)
        self.bc_weight, self.aux_weight, self.hindsight = bc_weight, aux_weight, hindsight
        self.distance, self.goal_distance = distance, goal_distance
        self.smoothing = TargetSmoothing(
            policy_noise=policy_noise,
            noise_clip=noise_clip,
            action_bound=action_bound,
            action_spec=action_spec,
            action_key=self._key("action"),
            generator=generator,
        )
        self.make_value_estimator()

    def _adopt_networks(self, actor: Any, critic: Any, staggered: bool) -> None:
        one = isinstance(critic, TensorDictModuleBase)
        joined: Any = critic if one else SideBySide(list(critic))
        self._adopt(actor, "actor_network", with_target=True)
        self._adopt(joined, "critic_network", with_target=True)
        self.has_delayed_critic = staggered and one
        if self.has_delayed_critic:
            # By way of _modules: the attribute warns that nothing updates the targets yet.
            copy: Any = deepcopy(self._modules["target_critic_network_params"])
            self.target_delayed_critic_network_params = copy
            self._has_update_associated["delayed_critic_network"] = False

    @property
    def delayed_critic_network_params(self) -> TensorDictParams:
        """What the delayed targets follow: torchrl's updaters look targets' sources up by name."""
        return self.critic_network_params

    @property
    def in_keys(self) -> list[NestedKey]:
        """Everything that is read; masks and weights may be missing."""
        state = unique_keys(self.actor_network.in_keys, self.critic_network.in_keys)
        names = ["action", "perturbed"]
        names += ["expert_action", "has_expert"] * (self.bc_weight > 0)
        if self._predicts_goal(self.actor_network) or self._predicts_goal(self.critic_network):
            names += ["goal", "has_goal"] + ["episode_success"] * self.hindsight
        following = [("next", key) for key in state if key != self._key("action")]
        return unique_keys(state, self._optional_keys(*names), following, self._ahead_keys())

    def _terms(self) -> list[NestedKey]:
        """The terms that this configuration has, then figures without gradients."""
        terms = {
            "loss_qvalue": True,
            "loss_critic_aux": self._predicts_goal(self.critic_network),
            "loss_actor_bc": self.bc_weight > 0,
            "loss_actor_ddpg": self.bc_weight < 1,
            "loss_actor_aux": self._predicts_goal(self.actor_network),
        }
        return [*(key for key, present in terms.items() if present), "td_error", "pred_value", "target_value"]

    @dispatch()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A batch to all terms and figures."""
        return self.critic_loss(tensordict).update(self.actor_loss(tensordict))

    def critic_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The terms of Eq. (3), and the figures `td_error`, `pred_value` and `target_value`."""
        target = self._target_value(tensordict)
        predicts_goal = self._predicts_goal(self.critic_network)
        written = self._run(
            self.critic_network, self.critic_network_params, tensordict, predict_goal=predicts_goal
        )
        value = self._written(written, "state_action_value")
        error = value - target  # (*, Q)
        mask = self._mask(tensordict, "perturbed", value.shape[:-1])
        mask = None if mask is None else ~mask
        out = {"loss_qvalue": self._reduce(0.5 * error.square().sum(dim=-1), tensordict, mask)}
        if predicts_goal:
            out["loss_critic_aux"] = self._weighted_goal_term(written, tensordict)
        out["td_error"] = self._write_priority(error.detach().abs().amax(dim=-1), tensordict, mask)
        out["pred_value"], out["target_value"] = value.detach().mean(), target.mean()
        return TensorDict(out, [])

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Eq. (3) as one number, as TD3Loss gives it, and what `critic_loss` writes, without gradients."""
        out = self.critic_loss(tensordict)
        terms = [value for key, value in out.items() if key.startswith("loss_")]
        return torch.stack(terms).sum(dim=0), dict(out.detach().items())

    def _write_priority(self, error: Tensor, tensordict: TensorDictBase, mask: Tensor | None) -> Tensor:
        """Write each sample's error (*), and return the mean of those that count.

        What is not trained keeps its error for ever, and as a priority it would crowd out the rest:
        the mean stands in for it.
        """
        counted = self._counted(error, tensordict, mask)
        mean = functional.masked_mean(error, counted)
        tensordict.set(self._key("priority"), torch.where(counted, error, mean))
        return mean

    def actor_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The terms of Eq. (4)."""
        predicts_goal = self._predicts_goal(self.actor_network)
        written = self._run(
            self.actor_network, self.actor_network_params, tensordict, predict_goal=predicts_goal
        )
        action = self._written(written, "action")
        out = {}
        if self.bc_weight > 0:
            out["loss_actor_bc"] = self.bc_weight * self._imitation_term(action, tensordict, self.distance)
        if self.bc_weight < 1:
            value = self._first_value(tensordict, action)
            out["loss_actor_ddpg"] = (self.bc_weight - 1) * self._reduce(value, tensordict)
        if predicts_goal:
            out["loss_actor_aux"] = self._weighted_goal_term(written, tensordict)
        return TensorDict(out, [])

    def _first_value(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Q1(s, action), (*), with gradients to the action alone."""
        inputs = tensordict.select(*self.critic_network.in_keys, strict=False).set(
            self._key("action"), action
        )
        return self._values(self.critic_network_params.detach(), inputs, slice(0, 1))[..., 0]

    @torch.no_grad()
    def _target_value(self, tensordict: TensorDictBase) -> Tensor:
        """Target y of Eq. (3), (*, 1)."""
        following = self._following(tensordict)
        params = self.target_actor_network_params
        acted = self._run(self.actor_network, params, following, keep_statistics=True, predict_goal=False)
        following.set(self._key("action"), self.smoothing(self._written(acted, "action")))
        least = self._target_values(following).amin(dim=-1, keepdim=True)
        return self._look_ahead(tensordict, least)

    def _following(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The next states; no entry of the present ones stands in for what they lack."""
        networks = (self.actor_network, self.critic_network)
        state = [key for key in unique_keys(*(n.in_keys for n in networks)) if key != self._key("action")]
        self._require(
            tensordict,
            [unravel_key(("next", key)) for key in state],
            "Record them with each transition; what stays the same may be copied there from the root.",
        )
        # Anew, since dispatch may have guessed more dimensions of the batch, which a lazy stack cannot shed.
        entries = {key: tensordict.get(("next", key)) for key in state}
        return TensorDict(entries, tensordict.batch_size, device=tensordict.device)

    def _target_values(self, following: TensorDictBase) -> Tensor:
        """(*, Q): the first value from the targets that follow, the others from those copied."""
        heads = slice(0, 1) if self.has_delayed_critic else slice(None)
        values = self._values(self.target_critic_network_params, following, heads)
        count = getattr(self.critic_network, "num_values", values.shape[-1])
        if not self.has_delayed_critic or count == 1:
            return values
        others = self._values(self.target_delayed_critic_network_params, following, slice(1, None))
        return torch.cat((values[..., :1], others[..., 1 - count :]), dim=-1)

    def _values(
        self, params: TensorDictParams | TensorDictBase, inputs: TensorDictBase, heads: slice
    ) -> Tensor:
        """(*, q) of a GraspCritic's heads, (*, Q) of any other critic; statistics stay."""
        written = self._run(
            self.critic_network, params, inputs, keep_statistics=True, predict_goal=False, values=heads
        )
        return self._written(written, "state_action_value")

    def _predicts_goal(self, network: TensorDictModuleBase) -> bool:
        return self.aux_weight > 0 and self._writes(network, "goal_prediction")

    def _weighted_goal_term(self, written: TensorDictBase, tensordict: TensorDictBase) -> Tensor:
        predicted = self._written(written, "goal_prediction")
        term = self._goal_term(predicted, tensordict, self.goal_distance, success_only=self.hindsight)
        return self.aux_weight * term
