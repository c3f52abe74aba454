"""The policies that recipes evaluate: by name, or a trained one."""

from __future__ import annotations

from pathlib import Path

import common
from hydra.utils import instantiate
from networks import join_policy, load_acting
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase

from torchgrasp.planning import OpenLoopPolicy, RandomAction, Relay


def make_policy(cfg: DictConfig, name: str) -> TensorDictModuleBase:
    """The policy `name`: one of `settings.POLICIES`, or a run directory or weights file."""
    if name == "expert":
        return common.make_expert(cfg, "test")
    if name == "random":
        return RandomAction(action_bound=common.make_actions(cfg).bound, seed=cfg.evaluation.seed)
    if name == "planning":
        return make_planning(cfg)
    if name == "combined":
        return _relay(cfg, name, make_planning(cfg), make_policy(cfg, str(cfg.learner)))
    if name == "takeover":
        return _relay(cfg, name, make_policy(cfg, str(cfg.learner)), common.make_expert(cfg, "test"))
    return load_actor(Path(name))


def make_planning(cfg: DictConfig) -> OpenLoopPolicy:
    """One planned trajectory an episode, for the objects of the evaluation."""
    return instantiate(
        cfg.planning,
        common.make_objects(cfg, "test"),
        horizon=cfg.env.horizon,
        action_space=common.make_actions(cfg),
        seed=cfg.evaluation.seed,
    )


def load_actor(path: Path) -> TensorDictModuleBase:
    """The trained actor of a run directory or weights file, behind its goal network if it reads goals."""
    return join_policy(load_acting(path))


def _relay(cfg: DictConfig, name: str, first: TensorDictModuleBase, second: TensorDictModuleBase) -> Relay:
    return Relay(first, second, steps=cfg[name].steps, horizon=cfg.env.horizon, seed=cfg.evaluation.seed)
