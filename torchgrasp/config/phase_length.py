"""How long a run's main phase is: in steps online, in updates offline."""

from __future__ import annotations

from omegaconf import DictConfig


def count_rounds(cfg: DictConfig) -> int:
    """Rounds of all worlds of a worker that give an iteration its episodes."""
    return -(-cfg.collector.episodes // cfg.env.num_envs)


def count_offline_updates(cfg: DictConfig) -> int:
    """Updates on demonstrations alone; 0 where the run is online."""
    if cfg.offline.updates != "auto":
        return cfg.offline.updates
    steps = count_rounds(cfg) * cfg.env.num_envs * cfg.env.horizon  # of an iteration, none ending early
    return -(-cfg.total_env_steps // steps) * cfg.online.updates
