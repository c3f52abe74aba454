"""Workers that may die: each has a thread here that feeds it, replaces it and runs its episode again."""

from __future__ import annotations

import pickle
import threading
import traceback
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from queue import PriorityQueue
from typing import Any

from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.rollouts.episode_pool import EpisodeBatches, EpisodePool, EpisodeRunner, MakeEnv, Policy

# Deaths over the same episode after which it is the episode's fault, not the worker's.
_MAX_DEATHS = 3


class WorkerLostError(Exception):
    """What worked on an episode is gone; the text says how."""


@dataclass(order=True)
class Task:
    """One episode number of all worlds that somebody waits for; the order is that of the requests."""

    order: int
    env: str = field(compare=False)
    policy: Any = field(compare=False)  # as `WorkerPool._publish` gives it
    number: int = field(compare=False)
    explore: bool = field(compare=False)
    answer: Future[bytes] = field(compare=False, default_factory=Future)
    deaths: int = field(compare=False, default=0)


class Worker(ABC):
    """Runs one task after another somewhere else.

    Attributes:
        name: tells which one it is, for a warning.
    """

    name: str

    @abstractmethod
    def run(self, task: Task) -> bytes:
        """What `answer` made of the task; raises WorkerLostError where none comes."""

    @abstractmethod
    def stop(self) -> None:
        """Kill it, from any thread, at any time, more than once: `run` then raises WorkerLostError."""


class WorkerPool(EpisodePool):
    """Shares episodes out among workers, whichever is free; subclasses say what a worker is.

    A worker that dies (SIGKILL, out of memory, a machine that is gone) is named in a warning and replaced,
    and its episode is run again: numbered, it is the same one. Three deaths over one episode are an error.

    Args:
        envs: name -> function that makes the environment; can be pickled.
        num_workers: how many; each makes its own environments.
        keep: as for every pool.
    """

    def __init__(
        self, envs: Mapping[str, MakeEnv], *, num_workers: int, keep: Iterable | None = None
    ) -> None:
        if num_workers < 1:
            raise ConfigError(
                f"num_workers={num_workers}: give 1 or more, or take a SerialPool, which needs none."
            )
        super().__init__(envs, keep=keep)
        self._waiting: PriorityQueue[Task] = PriorityQueue()
        self._orders = count()
        self._closing = threading.Event()
        self._workers: dict[int, Worker] = {}
        self._threads = [
            threading.Thread(target=self._feed, args=(index,), name=f"episodes-{index}", daemon=True)
            for index in range(num_workers)
        ]

    @abstractmethod
    def _start_worker(self, index: int) -> Worker:
        """A new worker; raises WorkerLostError where it could not begin."""

    def _publish(self, policy: Policy) -> Any:
        """The policy in the form that tasks carry."""
        return pickle.dumps(policy)

    def run(
        self, env: str, policy: Policy, numbers: Iterable[int], *, explore: bool = False
    ) -> EpisodeBatches:
        """One list an episode number; the workers begin at once."""
        for thread in self._threads:
            if thread.ident is None:
                thread.start()
        shared = self._publish(policy)
        tasks = [Task(next(self._orders), env, shared, number, explore) for number in numbers]
        batches = self._hand_over(tasks)
        next(batches)  # begun: from here on, closing it drops its tasks
        return batches

    def _hand_over(self, tasks: Sequence[Task]) -> EpisodeBatches:
        for task in tasks:
            self._waiting.put(task)
        try:
            yield []
            for task in tasks:
                yield read_answer(task.answer.result())
        finally:
            for task in tasks:  # those that nobody waits for any longer
                task.answer.cancel()

    def _feed(self, index: int) -> None:
        """The life of a thread: tasks for one worker and its successors."""
        while not self._closing.is_set():
            task = self._waiting.get()
            if self._closing.is_set() or task.answer.cancelled():
                task.answer.cancel()
                continue
            try:
                done = self._worker(index).run(task)
            except WorkerLostError as death:
                self._bury(index, task, death)
            except Exception as error:
                _settle(task, error)
            else:
                _settle(task, done)
        self._end(index)

    def _worker(self, index: int) -> Worker:
        """The worker of a thread, a new one where there is none."""
        if index not in self._workers:
            self._workers[index] = self._start_worker(index)
            if self._closing.is_set():  # too late for `close` to see it
                self._workers[index].stop()
        return self._workers[index]

    def _bury(self, index: int, task: Task, death: WorkerLostError) -> None:
        """Take note of a death, and queue the task again where there is hope."""
        dead = self._end(index)
        if self._closing.is_set():
            task.answer.cancel()
            return
        name = dead.name if dead is not None else f"Worker {index}"
        what = f"episode {task.number} of the environment {task.env!r}"
        task.deaths += 1
        if task.deaths < _MAX_DEATHS:
            told = f"{name} {death}: another takes its place and runs {what} again."
            warnings.warn(told, stacklevel=1)
            self._waiting.put(task)
            return
        message = (
            f"{what[0].upper()}{what[1:]} cost {task.deaths} workers their lives; the last, {name}, {death}. "
            "If memory ran out, lower num_workers; a SerialPool shows other errors."
        )
        _settle(task, TorchgraspError(message))

    def _end(self, index: int) -> Worker | None:
        worker = self._workers.pop(index, None)
        if worker is not None:
            worker.stop()
        return worker

    def close(self) -> None:
        """End the workers, whatever they are at."""
        self._closing.set()
        for _ in self._threads:
            self._waiting.put(Task(-1, "", None, 0, False))
        for worker in list(self._workers.values()):
            worker.stop()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        while not self._waiting.empty():  # whoever still waits is told
            self._waiting.get().answer.cancel()


def _settle(task: Task, outcome: bytes | Exception) -> None:
    with suppress(InvalidStateError):  # dropped meanwhile
        if isinstance(outcome, Exception):
            task.answer.set_exception(outcome)
        else:
            task.answer.set_result(outcome)


def answer(runner: EpisodeRunner, env: str, policy: bytes, number: int, explore: bool) -> bytes:
    """What a worker makes of a task: pickled (True, episodes) or (False, error).

    Bytes rather than tensors, which torch would send as file descriptors.
    """
    try:
        return pickle.dumps((True, runner.run(env, pickle.loads(policy), number, explore)))
    except Exception as error:
        told = traceback.format_exc()
        try:
            error.add_note(f"In a worker:\n{told}")
            packed = pickle.dumps((False, error))
            pickle.loads(packed)
        except Exception:  # of a class that cannot travel
            packed = pickle.dumps((False, RuntimeError(f"In a worker:\n{told}")))
        return packed


def read_answer(packed: bytes) -> list:
    """The episodes that `answer` packed; raises the error that stopped them."""
    fine, value = pickle.loads(packed)
    if not fine:
        raise value
    return value
