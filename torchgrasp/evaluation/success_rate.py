"""Success of a policy on numbered scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.rollouts import Episode, EpisodePool
from torchgrasp.rollouts.episode_pool import run_episodes
from torchgrasp.runs import Progress


def evaluate_policy(
    pool: EpisodePool,
    policy: Callable,
    *,
    num_episodes: int,
    num_envs: int,
    description: str,
    by: Mapping[str, Callable[[Episode], str]] | None = None,
    watch: Iterable[Callable[[Episode], None]] = (),
) -> dict:
    """Success of a policy on the first scenes of the pool's environment `test`, and the steps that it took.

    Args:
        pool: who runs the episodes.
        policy: a copy of it acts, on the CPU.
        num_episodes: that count.
        num_envs: worlds of the environment; with its seed they fix the scenes.
        description: of the progress bar.
        by: {name: function} that names the group of an episode; adds a table of the groups under each name.
        watch: each is shown every episode that counts.

    Returns:
        `SuccessTable.summary()`, the tables of `by`, and `env_steps`.
    """
    table, num_steps, watchers = SuccessTable(), 0, list(watch)
    groups = {name: SuccessTable() for name in by or {}}
    episodes = run_episodes(pool, "test", policy, num_episodes=num_episodes, num_envs=num_envs)
    with Progress(num_episodes, description=description, unit="episode") as progress:
        for episode in episodes:
            table.add(episode.object_name, episode.success, cause=episode.failure)
            for name, group in (by or {}).items():
                groups[name].add(group(episode), episode.success, cause=episode.failure)
            for each in watchers:
                each(episode)
            num_steps += len(episode.steps)
            progress.update(success_rate=table.success_rate)
    return {**table.summary(), **{name: each.rows() for name, each in groups.items()}, "env_steps": num_steps}
