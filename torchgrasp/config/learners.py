"""Learners, composed of the networks, losses and optimizers of a configuration."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.config.acceleration_choice import make_acceleration
from torchgrasp.config.environments import make_actions
from torchgrasp.config.kept_features import keep_features
from torchgrasp.config.networks import begin_networks, load_base, make_mirror, make_networks
from torchgrasp.config.parts import build
from torchgrasp.config.residual import has_residual, imitation_config, without_residual
from torchgrasp.config.weights_files import read_trained
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_SIZE, GOAL_SIZE
from torchgrasp.modules.goal_keys import predicts_goal
from torchgrasp.objectives import (
    GoalAuxLoss,
    GraspTD3BCLoss,
    PoseBCLoss,
    StaggeredTargetUpdate,
    functional,
)
from torchgrasp.objectives.grasp_loss import Distance
from torchgrasp.runs.checkpoint import checkpoint_exists
from torchgrasp.training import ActorCriticLearner, ImitationLearner


def make_first_learner(cfg: DictConfig) -> ImitationLearner:
    """Who learns first: where imitation makes the base of a residual, the actor alone, else all networks.

    What is wrong with the networks and losses that follow is refused here, before anything is learned.
    """
    if find_successor(cfg) is None:
        return make_actor_critic(cfg)
    if cfg.init is not None and not checkpoint_exists(cfg.resume):
        _check_begun(Path(str(cfg.init)), cfg.trust)
    first = imitation_config(cfg)
    with torch.random.fork_rng(devices=[]):
        make_actor_critic(cfg, make_imitation_learner(first))
    return make_imitation_learner(first)


def _check_begun(init: Path, trust: Iterable[str]) -> None:
    if has_residual(read_trained(init, trust).config):
        raise ConfigError(
            f"init={init} has been corrected by reinforcement: imitation would change what is corrected. "
            "Give pretrain.steps=0, and its correction goes on."
        )


def find_successor(cfg: DictConfig) -> Callable[[ImitationLearner], ActorCriticLearner] | None:
    """What makes the learner of the main phase of the first one; None where that goes on."""
    if not has_residual(cfg) or not cfg.pretrain.steps:
        return None
    return functools.partial(make_actor_critic, cfg)


def make_imitation_learner(cfg: DictConfig) -> ImitationLearner:
    """Actor, and goal network where the actor reads goals, at their first weights or those of `init`.

    It has no residual: imitation trains the actor itself.
    """
    cfg = without_residual(cfg)
    networks = _first_networks(cfg, critic=False)
    imitation = _make_imitation(cfg, keep_features(cfg, networks).networks, *_distances(cfg.loss))
    return ImitationLearner(networks, **imitation, **_make_optimizers(cfg, networks))


def make_actor_critic(cfg: DictConfig, before: ImitationLearner | None = None) -> ActorCriticLearner:
    """Actor, critic, and goal network where the actor reads goals, with the losses of Eq. (3) to (5).

    Args:
        cfg: the recipe's configuration.
        before: whose actor has learned by imitation and becomes the base of `model.residual`.
    """
    base = None if before is None else before.actor
    networks = _first_networks(cfg, critic=True, base=base)
    learning = keep_features(cfg, networks).networks
    loss = _make_loss(cfg, learning).to(cfg.device)
    loss.make_value_estimator(gamma=cfg.online.gamma)
    return ActorCriticLearner(
        networks,
        loss=loss,
        targets=StaggeredTargetUpdate(loss, tau=cfg.online.tau, period=cfg.online.period),
        **_make_imitation(cfg, learning, loss.distance, loss.goal_distance),
        **_make_optimizers(cfg, networks),
        policy_delay=cfg.online.policy_delay,
    )


def _make_loss(cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase]) -> GraspTD3BCLoss:
    """The loss of actor and critic, within limits of its own or else those of the environment's actions."""
    own = [name for name in ("action_bound", "action_spec") if cfg.loss.get(name) is not None]
    limits = {} if own else {"action_bound": make_actions(cfg).bound}
    return build(cfg.loss, networks["actor"], networks["critic"], **limits)


def _first_networks(
    cfg: DictConfig, *, critic: bool, base: TensorDictModuleBase | None = None
) -> dict[str, TensorDictModuleBase]:
    """The networks on their device; a run that goes on has weights of its own."""
    fresh = base is None and not checkpoint_exists(cfg.resume)
    if fresh and has_residual(cfg) and cfg.init is not None:
        base = load_base(cfg)
    networks = make_networks(cfg.model, critic=critic, base=base)
    networks = {name: each.to(cfg.device) for name, each in networks.items()}
    if fresh and base is None:
        begin_networks(cfg, networks)
    return networks


def _make_optimizers(cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase]) -> dict[str, Any]:
    """How the updates are run, and an optimizer of each network for that, by argument of the learner."""
    acceleration = make_acceleration(cfg)
    optimizers = {name: acceleration.make_adam(each.parameters()) for name, each in networks.items()}
    return {"acceleration": acceleration, "optimizers": optimizers}


def _make_imitation(
    cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase], distance: Distance, goal_distance: Distance
) -> dict[str, Any]:
    """The losses of imitation, by argument of the learner."""
    for measure, size in ((distance, ACTION_SIZE), (goal_distance, GOAL_SIZE)):
        # Refuses a wrong norm before anything is collected.
        measure(torch.ones(1, size), torch.ones(1, size))
    actor, grasp_prediction = networks["actor"], None
    if "goal_network" in networks:
        grasp_prediction = GoalAuxLoss(networks["goal_network"], distance=goal_distance)
        grasp_prediction.set_keys(goal_prediction=keys.GOAL)
    aux_weight = cfg.pretrain.aux_weight if predicts_goal(actor) else 0.0
    imitation = PoseBCLoss(actor, distance=distance, aux_weight=aux_weight, goal_distance=goal_distance)
    mirror = make_mirror(cfg.model)
    return {"imitation": imitation, "grasp_prediction": grasp_prediction, "mirror": mirror}


def _distances(loss: DictConfig) -> tuple[Distance, Distance]:
    """L_POSE between actions and between goals, as `loss` has them."""
    defaults = {"distance": functional.action_distance, "goal_distance": functional.goal_distance}
    chosen = {name: OmegaConf.select(loss, name) for name in defaults}
    action, goal = (defaults[name] if each is None else build(each) for name, each in chosen.items())
    return action, goal
