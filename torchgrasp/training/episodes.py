"""Numbered episodes, run by worker processes: the same ones whatever the number of workers."""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchgrasp import keys
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.training.outcomes import failure_cause

# Makes a GraspEnv with transforms around it.
MakeEnv = Callable[[], Any]


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


class EpisodePool:
    """Runs episodes of GraspEnvs in worker processes and hands them over in order.

    An episode is named by (environment, world, number); which worker runs it changes nothing. The
    workers live as long as the pool, which is a context manager.

    Args:
        envs: name -> picklable function that makes the environment.
        num_workers: processes; 0 runs everything in this one.
        keep: keys of a step that are handed over besides those of "next" that end an episode.
    """

    def __init__(
        self, envs: Mapping[str, MakeEnv], *, num_workers: int = 0, keep: Iterable | None = None
    ) -> None:
        if num_workers < 0:
            raise ConfigError(f"collector.num_workers={num_workers}: give 0 (this process) or more.")
        self._runner = _Runner(dict(envs), None if keep is None else list(keep))
        self._executor: ProcessPoolExecutor | None = None
        if num_workers:
            self._executor = ProcessPoolExecutor(
                num_workers,
                mp_context=get_context("spawn"),
                initializer=_start_worker,
                initargs=(self._runner,),
            )
        self._num_workers = num_workers

    def run(
        self,
        env: str,
        policy: Callable[[TensorDictBase], TensorDictBase],
        numbers: Iterable[int],
        *,
        explore: bool = False,
    ) -> Iterator[list[Episode]]:
        """For each episode number one list: that episode of every world of the environment, in order.

        Args:
            env: name of the environment.
            policy: picklable; it works on a copy where there are workers.
            numbers: of the episodes.
            explore: whether modules that explore do so.
        """
        if self._executor is None:
            for number in numbers:
                yield self._runner.run(env, policy, number, explore)
            return
        packed = pickle.dumps(policy)
        waiting: list[Future] = []
        try:
            waiting += [self._executor.submit(_work, env, packed, n, explore) for n in numbers]
            for future in waiting:
                yield pickle.loads(future.result())
        except BrokenProcessPool as error:
            raise TorchgraspError(
                f"One of {self._num_workers} worker processes died, killed or out of memory: lower "
                "collector.num_workers or env.num_envs, then go on with resume=<run dir>."
            ) from error
        finally:
            for future in waiting:  # those that nobody waits for any longer
                future.cancel()

    def close(self) -> None:
        """End the workers."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)

    def __enter__(self) -> EpisodePool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Runner:
    """Makes each environment once and runs episodes in it."""

    def __init__(self, factories: dict[str, MakeEnv], keep: list | None) -> None:
        self.factories = factories
        self.keep = keep
        self.envs: dict[str, Any] = {}

    def __getstate__(self) -> dict:
        return {"factories": self.factories, "keep": self.keep, "envs": {}}

    def run(self, name: str, policy: Callable, number: int, explore: bool) -> list[Episode]:
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
        gaps = env.base_env.worlds.joints[:, 7:].sum(-1)
        for row, gap in zip(batch, gaps, strict=True):
            length = int(row["next", "done"].squeeze(-1).int().argmax()) + 1
            object_name = names[int(row[keys.OBJECT_ID][0])]
            world = int(row[keys.WORLD][0])
            failure = failure_cause(row[:length], float(gap))
            if self.keep is not None:
                row = row.select(*self.keep, *(("next", key) for key in self.keep), *ends, strict=False)
            episodes.append(Episode(row[:length].clone(), object_name, world, number, failure))
        return episodes


_runner: _Runner | None = None


def _start_worker(runner: _Runner) -> None:
    global _runner
    torch.set_num_threads(1)
    _runner = runner
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _work(env: str, policy: bytes, number: int, explore: bool) -> bytes:
    # Bytes rather than tensors, which torch would send as file descriptors.
    assert _runner is not None
    return pickle.dumps(_runner.run(env, pickle.loads(policy), number, explore))
