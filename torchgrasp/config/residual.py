"""A residual in a configuration: what goes with it, and the imitation that may come before it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from torchgrasp.errors import ConfigError


def has_residual(cfg: Mapping[Any, Any]) -> bool:
    """Whether the actor of a configuration, one's own or that of trained weights, is corrected."""
    return cfg["model"].get("residual") is not None


def without_residual(cfg: DictConfig) -> DictConfig:
    """The same configuration of the actor alone, as imitation trains it."""
    alone = cfg.copy()
    OmegaConf.update(alone, "model.residual", None, force_add=True)
    return cast(DictConfig, alone)


def imitation_config(cfg: DictConfig) -> DictConfig:
    """What imitation works with where a residual follows it: the actor alone, and no episodes of its own."""
    alone = without_residual(cfg)
    alone.replay.online_capacity = 1
    alone.replay.keep_features = "auto"
    if cfg.replay.folder is not None:
        alone.replay.folder = f"{cfg.replay.folder}/imitation"
    return alone


def check_residual(cfg: DictConfig) -> None:
    """Refuse what does not go together with a residual."""
    if not has_residual(cfg):
        return
    if cfg.recipe != "hindsight" and cfg.pretrain.critic:
        raise ConfigError(
            "pretrain.critic=true with model.residual: the critic reads the features of the trained actor, "
            "and begins after imitation. Give pretrain.critic=false."
        )
    for name in ("actor", "critic"):
        if cfg.model[name].get("goal_input"):
            raise ConfigError(
                f"model.{name}.goal_input=true with model.residual: nobody tells goals while it learns. Give "
                f"model.{name}.goal_input=false, or model.residual=null."
            )
    residual, tries = cfg.model.residual, cfg.collector.get("tries")
    for place, horizon in (("model.residual", residual), ("collector.tries", tries)):
        given = None if horizon is None else horizon.get("horizon")
        if given is not None and given != cfg.env.horizon:
            raise ConfigError(
                f"{place}.horizon={given} with env.horizon={cfg.env.horizon}: give it the same horizon."
            )
