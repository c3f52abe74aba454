"""How long a run's main phase is, and where its rate falls."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from torchgrasp.errors import ConfigError, check_range, check_whole

_RATES = ("pretrain.learning_rate", "online.learning_rate", "online.decay")


def count_rounds(cfg: DictConfig) -> int:
    """Rounds of all worlds of a worker that give an iteration its episodes."""
    return -(-cfg.collector.episodes // cfg.env.num_envs)


def count_offline_updates(cfg: DictConfig) -> int:
    """Updates on demonstrations alone; 0 where the run is online."""
    if cfg.offline.updates != "auto":
        return cfg.offline.updates
    steps = count_rounds(cfg) * cfg.env.num_envs * cfg.env.horizon  # of an iteration, none ending early
    return -(-cfg.total_env_steps // steps) * cfg.online.updates


def check_schedule(cfg: DictConfig) -> None:
    """Refuse lengths, rates and milestones that no run can have; a recipe without them passes."""
    updates = OmegaConf.select(cfg, "offline.updates", default=0)
    if updates != "auto":
        check_whole("offline.updates", updates, 0)
    elif not cfg.total_env_steps:
        raise ConfigError(
            "offline.updates=auto makes as many as total_env_steps would, which is 0: give their number."
        )
    for name in _RATES:
        check_range(name, OmegaConf.select(cfg, name, default=0.0), 0.0, float("inf"))
    if "online" in cfg:
        check_milestones("online.milestones", cfg.online.milestones)


def check_milestones(name: str, milestones: Any) -> None:
    """Refuse what is no list of shares of a run in increasing order."""
    shares: list[Any] = list(milestones) if isinstance(milestones, ListConfig) else [None]
    numbers = [each for each in shares if type(each) in (int, float) and 0.0 <= each <= 1.0]
    if len(numbers) < len(shares) or numbers != sorted(set(numbers)):
        raise ConfigError(
            f"{name}={milestones}: give shares of the run from 0 to 1, each once and in order, such as "
            "[0.4, 0.7], or [] for a rate that stays."
        )
