"""Numbered episodes and who runs them: the same ones in one process, in several, on several machines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts.outcomes import failure_cause

# Makes a GraspEnv with a seed, since each worker makes its own, usually with transforms around it.
MakeEnv = Callable[[], Any]
Policy = Callable[[TensorDictBase], TensorDictBase]
# One list an episode number: that episode of every world.
EpisodeBatches = Generator["list[Episode]", None, None]


@dataclass(frozen=True)
class Episode:
    """One episode: its steps (T), the object's name, the world and number that fix its scene.

    `failure` tells why the object was not lifted, None where it was.
    """

    steps: TensorDictBase
    object_name: str
    world: int
    number: int
    failure: str | None = None

    @property
    def success(self) -> bool:
        """Whether the object was lifted."""
        return bool(self.steps["next", "reward"].sum() > 0)


class EpisodePool(ABC):
    """Runs numbered episodes of GraspEnvs and hands them over in order.

    An episode is named by (environment, world, number): who runs it, beside whom and after what changes
    nothing in it. A pool is a context manager; what it started lives as long as it does.

    Args:
        envs: name -> function that makes the environment.
        keep: keys of a step that are handed over besides those of "next" that end an episode.
    """

    def __init__(self, envs: Mapping[str, MakeEnv], *, keep: Iterable | None = None) -> None:
        self._runner = EpisodeRunner(dict(envs), None if keep is None else list(keep))

    @abstractmethod
    def run(
        self, env: str, policy: Policy, numbers: Iterable[int], *, explore: bool = False
    ) -> EpisodeBatches:
        """For each episode number one list: that episode of every world of the environment, in order.

        Where there are workers they begin at once, with a copy of the policy as it is now. Closing what
        is returned drops the episodes that are still to come.

        Args:
            env: name of the environment.
            policy: can be pickled where there are workers.
            numbers: of the episodes.
            explore: whether modules that explore do so.
        """

    @property
    def work_seconds(self) -> float:
        """Seconds that workers have spent on episodes, all of them together; 0 where there are none."""
        return 0.0

    @abstractmethod
    def close(self) -> None:
        """End what the pool started."""

    def __enter__(self) -> EpisodePool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class SerialPool(EpisodePool):
    """Runs each episode in this process, when it is asked for.

    Args:
        envs: name -> function that makes the environment.
        num_workers: 0; there for the sake of the other pools.
        keep: as for every pool.

    Example:
        >>> from torchgrasp.envs import GraspEnv
        >>> from torchgrasp.objects import ProceduralObjects
        >>> from torchgrasp.planning import RandomAction
        >>> objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
        >>> with SerialPool({"train": lambda: GraspEnv(2, objects=objects, horizon=3, seed=0)}) as pool:
        ...     batches = list(pool.run("train", RandomAction(), [7, 8]))
        >>> [(episode.world, episode.number) for batch in batches for episode in batch]
        [(0, 7), (1, 7), (0, 8), (1, 8)]
    """

    def __init__(
        self, envs: Mapping[str, MakeEnv], *, num_workers: int = 0, keep: Iterable | None = None
    ) -> None:
        if num_workers != 0:
            raise ConfigError(
                f"num_workers={num_workers}: a SerialPool has no workers, give 0, or take a ProcessPool."
            )
        super().__init__(envs, keep=keep)

    def run(
        self, env: str, policy: Policy, numbers: Iterable[int], *, explore: bool = False
    ) -> EpisodeBatches:
        """One list an episode number; the policy itself acts, no copy."""
        for number in numbers:
            yield self._runner.run(env, policy, number, explore)

    def close(self) -> None:
        """Nothing was started."""


def copy_for_rollouts(policy: Policy) -> Policy:
    """A copy of the policy for environments, which run on the CPU, in evaluation mode."""
    return deepcopy(policy).to("cpu").eval() if isinstance(policy, nn.Module) else policy


def run_episodes(
    pool: EpisodePool, env: str, policy: Policy, *, num_episodes: int, num_envs: int
) -> Iterator[Episode]:
    """The first `num_episodes` episodes of an environment of `num_envs` worlds, by a copy of the policy.

    They are ordered by number, then by world, and nobody explores.
    """
    batches = pool.run(env, copy_for_rollouts(policy), range(-(-num_episodes // num_envs)))
    return islice(chain.from_iterable(batches), num_episodes)


class EpisodeRunner:
    """Makes each environment once and runs episodes in it; a copy of it makes them anew.

    Args:
        factories: name -> function that makes the environment.
        keep: keys that are handed over; None for all.
    """

    def __init__(self, factories: dict[str, MakeEnv], keep: list | None) -> None:
        self.factories = factories
        self.keep = keep
        self.envs: dict[str, Any] = {}

    def __getstate__(self) -> dict:
        return {"factories": self.factories, "keep": self.keep, "envs": {}}

    def run(self, name: str, policy: Policy, number: int, explore: bool) -> list[Episode]:
        """The episode `number` of every world of an environment."""
        if name not in self.envs:
            self.envs[name] = self.factories[name]()
        env = self.envs[name]
        env.start_episodes_at([number] * env.batch_size[0])
        mode = ExplorationType.RANDOM if explore else ExplorationType.DETERMINISTIC
        with torch.no_grad(), set_exploration_type(mode):
            batch = env.rollout(env.horizon, policy, break_when_any_done=False, break_when_all_done=True)
        names = env.objects.names
        ends = [("next", key) for key in ("reward", "terminated", "truncated", "done")]
        episodes = []
        worlds = getattr(env, "base_env", env).worlds
        gaps = worlds.joints[:, 7:].sum(-1)
        for row, gap, unstable in zip(batch, gaps, worlds.unstable, strict=True):
            length = int(row["next", "done"].squeeze(-1).int().argmax()) + 1
            object_name = names[int(row[keys.OBJECT_ID][0])]
            world = int(row[keys.WORLD][0])
            failure = failure_cause(row[:length], float(gap), unstable=bool(unstable))
            if self.keep is not None:
                row = row.select(*self.keep, *(("next", key) for key in self.keep), *ends, strict=False)
            episodes.append(Episode(row[:length].clone(), object_name, world, number, failure))
        return episodes
