"""The main phase of a run: how long it is, and how far it has come."""

from __future__ import annotations

from dataclasses import dataclass

from omegaconf import DictConfig


def count_rounds(cfg: DictConfig) -> int:
    """Rounds of all worlds of a worker that give an iteration its episodes."""
    return -(-cfg.collector.episodes // cfg.env.num_envs)


def describe_idle_workers(cfg: DictConfig) -> str | None:
    """What to know where an iteration has fewer groups of worlds than workers; None where all have work."""
    workers, episodes, groups = cfg.collector.num_workers, cfg.collector.episodes, count_rounds(cfg)
    if workers <= groups:
        return None
    told = (
        f"{workers} workers share {groups} group{'s' * (groups != 1)} of env.num_envs={cfg.env.num_envs} "
        f"worlds an iteration (collector.episodes={episodes}): no more than {groups} can be busy at once."
    )
    # The most worlds with a group for each worker and as many episodes as now.
    fitting = (each for each in range(episodes // workers, 1, -1) if episodes % each == 0)
    worlds = next(fitting, 1)
    if worlds == cfg.env.num_envs:
        return told
    return f"{told} env.num_envs={worlds} makes {episodes // worlds} groups, of other scenes."


@dataclass(frozen=True)
class MainPhase:
    """Measured in updates on demonstrations where a run is offline, else in steps of its own episodes.

    Attributes:
        total_env_steps: of an online run; 0 for none.
        offline_updates: 0 for an online run.
        updates: of an iteration.

    Example:
        >>> phase = MainPhase(total_env_steps=0, offline_updates=50, updates=20)
        >>> [phase.updates_ahead(iteration) for iteration in (0, 1, 2)], phase.progress(2, env_steps=0)
        ([20, 20, 10], 0.8)
    """

    total_env_steps: int
    offline_updates: int
    updates: int

    @classmethod
    def of(cls, cfg: DictConfig) -> MainPhase:
        """That of a configuration; `offline.updates=auto` makes as many updates as the steps would."""
        offline = cfg.offline.updates
        if offline == "auto":
            steps = (
                count_rounds(cfg) * cfg.env.num_envs * cfg.env.horizon
            )  # of an iteration, none ending early
            offline = -(-cfg.total_env_steps // steps) * cfg.online.updates
        return cls(cfg.total_env_steps, offline, cfg.online.updates)

    @property
    def length(self) -> int:
        """Of the whole phase, in its unit."""
        return self.offline_updates or self.total_env_steps

    @property
    def unit(self) -> str:
        """What the phase is measured in."""
        return "update" if self.offline_updates else "step"

    def position(self, iteration: int, env_steps: int) -> int:
        """How far it is before an iteration, in its unit."""
        return min(self.offline_updates, iteration * self.updates) if self.offline_updates else env_steps

    def progress(self, iteration: int, env_steps: int) -> float:
        """The share that is done; 1 of a phase without length."""
        done = iteration * self.updates if self.offline_updates else env_steps
        return done / self.length if self.length else 1.0

    def updates_ahead(self, iteration: int) -> int:
        """Updates of an iteration: all of them, or the last ones of an offline run."""
        left = self.offline_updates - iteration * self.updates
        return min(self.updates, left) if self.offline_updates else self.updates
