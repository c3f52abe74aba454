"""Workers that may die: a thread here waits for each, replaces it and has its episode run again."""

from __future__ import annotations

import pickle
import threading
import time
import traceback
import warnings
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from itertools import islice
from queue import LifoQueue
from typing import Any, NamedTuple

from torchgrasp.errors import ConfigError, WorkerError, check_range
from torchgrasp.interruption import is_interrupted
from torchgrasp.rollouts.episode_pool import (
    Episode,
    EpisodeBatches,
    EpisodePool,
    EpisodeRunner,
    MakeEnv,
    Policy,
)

# Deaths over the same episode after which it is the episode's fault, not the worker's.
_MAX_DEATHS = 3
# Episode numbers that workers may be ahead of what is taken: more than a round of training has, as a rule.
AHEAD = 32
_RETRY_SECONDS = 5.0  # between two attempts to find a place for a worker


class Task(NamedTuple):
    """One episode number of all worlds; the policy is as `WorkerPool._publish` gives it."""

    env: str
    policy: Any
    number: int
    explore: bool


class WorkerLostError(Exception):
    """What worked on an episode is gone; the text says which worker it was, and how it ended.

    Args:
        told: the text.
        blameless: whether the episode had no part in it, as where a whole machine is gone.
    """

    def __init__(self, told: str, *, blameless: bool = False) -> None:
        super().__init__(told)
        self.blameless = blameless


class Worker(ABC):
    """Runs one task after another somewhere else.

    Attributes:
        ready: whether it has a place to work at; where it has none yet, `settle` waits for one.
    """

    ready = True

    def settle(self, is_hopeless: Callable[[], bool]) -> None:  # noqa: B027
        """Wait for a place; raises WorkerLostError where there is none and no hope, or after `stop`."""

    @abstractmethod
    def run(self, task: Task) -> bytes:
        """What `answer` made of the task; raises WorkerLostError where none comes."""

    @abstractmethod
    def stop(self) -> None:
        """Kill it, from any thread, at any time, more than once: `run` then raises WorkerLostError."""


class WorkerPool(EpisodePool):
    """Shares episodes out among workers, whichever is free; subclasses say what a worker is.

    A worker that dies (SIGKILL, out of memory, a machine that is gone) is named in a warning and replaced,
    and its episode is run again by whoever is free: numbered, it is the same one. Three deaths over one
    episode are an error, unless their machines went with them. A worker without a place holds up no other.
    Threads of `concurrent.futures` hand the episodes out. Its ProcessPoolExecutor marks the whole pool broken
    when one worker dies: it ends the others too, and does not tell which episode it was. Ray's own retries do
    not tell their caller of a death.

    Close it, or use `with`: a program that ends without that first runs all the episodes still asked for.

    Args:
        envs: name -> function that makes the environment; can be pickled.
        num_workers: how many; each makes its own environments.
        keep: as for every pool.
        patience: seconds in which no worker at all may have a place to work at before that is an error.
    """

    def __init__(
        self,
        envs: Mapping[str, MakeEnv],
        *,
        num_workers: int,
        keep: Iterable | None = None,
        patience: float = 120.0,
    ) -> None:
        if num_workers < 1:
            raise ConfigError(
                f"num_workers={num_workers}: give 1 or more, or take a SerialPool, which needs none."
            )
        check_range("patience", patience, 0.0, 86400.0)
        super().__init__(envs, keep=keep)
        self._num_workers, self._patience = num_workers, patience
        self._threads = ThreadPoolExecutor(num_workers)
        self._idle: LifoQueue[int] = LifoQueue()
        for index in reversed(range(num_workers)):
            self._idle.put(index)
        self._workers: dict[int, Worker] = {}
        self._losses: dict[int, WorkerLostError] = {}  # of workers that found no place
        self._work_seconds = [0.0] * num_workers  # one thread at a time has a worker
        self._settling: dict[int, threading.Thread] = {}
        self._worked = time.monotonic()  # when somebody last could
        self._closed = threading.Event()
        self._begins = threading.Lock()  # held where a worker or its thread begins, and where the pool ends

    @abstractmethod
    def _start_worker(self, index: int) -> Worker:
        """A new worker; raises WorkerLostError where it could not begin."""

    def _publish(self, policy: Policy) -> Any:
        """The policy in the form that tasks carry, made once a call of `run`."""
        return pickle.dumps(policy)

    def run(
        self, env: str, policy: Policy, numbers: Iterable[int], *, explore: bool = False
    ) -> EpisodeBatches:
        """One list an episode number; the workers begin at once.

        They are at most `AHEAD` numbers ahead of what is taken, so that answers do not pile up.
        """
        shared = self._publish(policy)
        self._losses.clear()  # of a run before: there may be places now
        batches = self._hand_over(Task(env, shared, number, explore) for number in numbers)
        next(batches)  # begun: from here on, closing it drops its tasks
        return batches

    def _hand_over(self, tasks: Iterator[Task]) -> EpisodeBatches:
        """First an empty list, then the episodes of each answer; closing it drops those that are to come."""
        answers: deque[Future[bytes]] = deque()
        episodes: list[Episode] = []
        ahead = max(AHEAD, 2 * self._num_workers)
        try:
            while True:
                further = islice(tasks, ahead - len(answers))
                answers.extend(self._threads.submit(self._insist, task) for task in further)
                yield episodes
                if not answers:
                    return
                episodes = read_answer(answers.popleft().result())
        finally:
            for each in answers:
                each.cancel()

    def _insist(self, task: Task) -> bytes:
        """The answer to a task, by as many workers as it takes."""
        deaths = 0
        while True:
            index, settling = self._idle.get(), False
            try:
                worker = self._find_worker(index)
                if not worker.ready:
                    settling = self._begin_settling(index, worker)
                    continue
                started = time.perf_counter()
                packed = worker.run(task)
                self._work_seconds[index] += time.perf_counter() - started
                self._worked = time.monotonic()
                return packed
            except WorkerLostError as death:
                deaths += not death.blameless
                self._bury(index, task, deaths, death)
            finally:
                if not settling:
                    self._idle.put(index)

    def _find_worker(self, index: int) -> Worker:
        """The worker of that index, a new one where there is none."""
        if self._closed.is_set():
            raise CancelledError
        if (loss := self._losses.pop(index, None)) is not None:
            raise WorkerError(f"{loss}, and no other worker has one: nobody runs episodes.")
        return self._workers.get(index) or self._replace(index)

    def _replace(self, index: int) -> Worker:
        """A new worker of that index, which `close` will see; raises CancelledError after it."""
        with self._begins:
            if self._closed.is_set():
                raise CancelledError
            worker = self._workers[index] = self._start_worker(index)
        return worker

    def _begin_settling(self, index: int, worker: Worker) -> bool:
        """Wait until a worker has a place, in a thread of its own: the others go on meanwhile.

        Raises CancelledError where the run is over, or a signal will end it.
        """
        with self._begins:
            if self._closed.is_set() or is_interrupted():
                raise CancelledError
            thread = threading.Thread(target=self._settle, args=(index, worker), daemon=True)
            thread.start()
            self._settling[index] = thread
        return True

    def _settle(self, index: int, worker: Worker) -> None:
        """Free a worker once it has a place, or another one where it was lost before."""
        since, told = time.monotonic(), ""

        def is_hopeless() -> bool:
            waited = time.monotonic() - max(since, self._worked)
            return waited > self._patience and not any(each.ready for each in list(self._workers.values()))

        try:
            while not worker.ready and not self._closed.is_set():
                try:
                    worker.settle(is_hopeless)
                    self._worked = time.monotonic()
                    self._losses.clear()
                except WorkerLostError as loss:
                    worker.stop()
                    if self._closed.is_set() or is_interrupted():
                        return
                    if is_hopeless():
                        self._losses[index] = loss
                        del self._workers[index]
                        return
                    if str(loss) != told:
                        warnings.warn(f"{loss}: it is tried again while others go on.", stacklevel=1)
                    told = str(loss)
                    if self._closed.wait(_RETRY_SECONDS):
                        return
                    worker = self._replace(index)
        except CancelledError:
            return
        finally:
            self._idle.put(index)

    def _bury(self, index: int, task: Task, deaths: int, death: WorkerLostError) -> None:
        """Tell of a death in a warning; raise an error where there is no hope in another worker."""
        if (worker := self._workers.pop(index, None)) is not None:
            worker.stop()
        if self._closed.is_set() or is_interrupted():  # a signal may end workers of others, such as Ray's
            raise CancelledError
        what = f"episode {task.number} of the environment {task.env!r}"
        if deaths == _MAX_DEATHS and not death.blameless:
            raise WorkerError(
                f"{deaths} workers died over {what}; the last: {death}. If memory ran out, lower "
                "num_workers; a SerialPool shows other errors."
            )
        warnings.warn(f"{death}: another takes its place and runs {what} again.", stacklevel=1)

    @property
    def work_seconds(self) -> float:
        """Seconds that the workers have spent on the episodes they answered, all of them together."""
        return sum(self._work_seconds)

    def close(self) -> None:
        """End the workers, whatever they are at."""
        with self._begins:
            self._closed.set()
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in list(self._workers.values()):
            worker.stop()
        for thread in list(self._settling.values()):
            thread.join()
        self._threads.shutdown()


def answer(runner: EpisodeRunner, task: Task) -> bytes:
    """What a worker makes of a task: pickled (True, episodes) or (False, error).

    Bytes rather than tensors, which torch would send as file descriptors.
    """
    try:
        policy = pickle.loads(task.policy)
        return pickle.dumps((True, runner.run(task.env, policy, task.number, task.explore)))
    except Exception as error:
        told = f"In a worker:\n{traceback.format_exc()}"
        try:
            error.add_note(told)
            packed = pickle.dumps((False, error))
            pickle.loads(packed)
        except Exception:  # of a class that cannot travel
            packed = pickle.dumps((False, RuntimeError(told)))
        return packed


def read_answer(packed: bytes) -> list:
    """The episodes that `answer` packed; raises the error that stopped them."""
    fine, value = pickle.loads(packed)
    if not fine:
        raise value
    return value
