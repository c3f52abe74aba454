"""The policies that recipes evaluate: by name, or a trained one."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase

from torchgrasp.config.environments import make_actions, make_expert, make_objects
from torchgrasp.config.networks import make_mirror, rebuild_acting
from torchgrasp.config.parts import at_place, build
from torchgrasp.config.weights_files import read_trained
from torchgrasp.modules.policy import join_policy
from torchgrasp.planning import OpenLoopPolicy, RandomAction, Relay

# What is evaluated besides trained policies; those of RELAYS need a learner.
POLICIES = ("expert", "random", "planning", "combined", "takeover")
RELAYS = ("combined", "takeover")


def make_policy(cfg: DictConfig, name: str) -> TensorDictModuleBase:
    """The policy `name`: one of `POLICIES`, or a run directory or weights file."""
    if name == "expert":
        return make_expert(cfg, "test")
    if name == "random":
        return RandomAction(action_bound=make_actions(cfg).bound, seed=cfg.evaluation.seed)
    if name == "planning":
        return _make_planning(cfg)
    if name == "combined":
        return _relay(cfg, name, _make_planning(cfg), make_policy(cfg, str(cfg.learner)))
    if name == "takeover":
        return _relay(cfg, name, make_policy(cfg, str(cfg.learner)), make_expert(cfg, "test"))
    trained = read_trained(Path(name), cfg.trust)
    return join_policy(rebuild_acting(trained), make_mirror(trained.config["model"]))


def _make_planning(cfg: DictConfig) -> OpenLoopPolicy:
    """One planned trajectory an episode, for the objects of the evaluation."""
    return build(
        cfg.planning,
        make_objects(cfg, "test"),
        horizon=cfg.env.horizon,
        action_space=make_actions(cfg),
        seed=cfg.evaluation.seed,
    )


def _relay(cfg: DictConfig, name: str, first: TensorDictModuleBase, second: TensorDictModuleBase) -> Relay:
    with at_place(name):
        return Relay(first, second, steps=cfg[name].steps, horizon=cfg.env.horizon, seed=cfg.evaluation.seed)
