"""Episodes in several processes of this machine."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing import forkserver, get_context, parent_process
from multiprocessing.connection import Connection

import torch

from torchgrasp.processes import serve_parent, tell_end
from torchgrasp.rollouts.worker_pool import Task, Worker, WorkerLostError, WorkerPool, answer

# Workers are copies of one process that has imported what they need and done nothing else: a fork of this one
# would share its threads and physics, and one spawned anew imports for eight seconds.
COPIES = get_context("forkserver")
_IMPORTED = [f"torchgrasp.{part}" for part in ("rollouts", "envs", "planning", "modules", "sim.loaded")]
_SERVER_IS_GONE = 255  # the exit code that multiprocessing gives to its children then
_STARTING = threading.Lock()  # multiprocessing keeps its children in a list without one


class ProcessPool(WorkerPool):
    """Runs episodes in `num_workers` processes, each on one core; see `WorkerPool`.

    They are copies of one process, that of multiprocessing's "forkserver", and share the memory of what it
    has imported. A program that uses a forkserver itself, and has started it, keeps its own: workers then
    import for themselves.

    Example:
        >>> import functools
        >>> from torchgrasp.envs import GraspEnv
        >>> from torchgrasp.objects import ProceduralObjects
        >>> from torchgrasp.planning import RandomAction
        >>> objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
        >>> make_env = functools.partial(GraspEnv, 2, objects=objects, horizon=3, seed=0)
        >>> with ProcessPool({"train": make_env}, num_workers=1) as pool:
        ...     (batch,) = pool.run("train", RandomAction(), [7])
        >>> [(episode.world, episode.number) for episode in batch]
        [(0, 7), (1, 7)]
    """

    def _start_worker(self, index: int) -> Worker:
        return ProcessWorker(index, pickle.dumps(self._runner))


class ProcessWorker(Worker):
    """A process at the other end of a pipe.

    Args:
        index: of the worker in its pool.
        runner: a pickled EpisodeRunner.
    """

    def __init__(self, index: int, runner: bytes) -> None:
        self._pipe, theirs = COPIES.Pipe()
        # A daemon ends with this process, even where nobody closes the pool.
        work = (theirs, runner, dict(os.environ))
        self._process = COPIES.Process(target=_serve, args=work, daemon=True)
        with _STARTING:
            start_server()
            self._process.start()
        theirs.close()  # so that its death closes the pipe
        self._name = f"Worker {index} (process {self._process.pid})"

    def run(self, task: Task) -> bytes:
        """Send the task and wait for its answer."""
        try:
            self._pipe.send(task)
            return self._pipe.recv_bytes()
        except (EOFError, OSError) as error:
            self._process.join(timeout=5)
            raise WorkerLostError(f"{self._name} {tell_end(self._process.exitcode)}") from error

    def stop(self) -> None:
        """Kill the process; it holds nothing that anybody misses."""
        self._process.kill()
        if self._process.exitcode == _SERVER_IS_GONE and self._process.pid is not None:
            with suppress(ProcessLookupError):  # which multiprocessing takes for dead
                os.kill(self._process.pid, signal.SIGKILL)


def start_server() -> None:
    """Have the process that workers are copies of import from where this one does; once is enough."""
    given = {name: os.environ.get(name) for name in ("PYTHONPATH", "PYTHONSAFEPATH")}
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        COPIES.set_forkserver_preload(_IMPORTED)
        forkserver.ensure_running()
    finally:
        for name, value in given.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _serve(pipe: Connection, packed: bytes, environment: dict[str, str]) -> None:
    """The life of a worker process."""
    parent = parent_process()
    serve_parent(None if parent is None else parent.sentinel)
    os.environ.clear()  # of the time when the first worker was started
    os.environ.update(environment)
    torch.set_num_threads(1)
    runner = pickle.loads(packed)
    with suppress(EOFError, BrokenPipeError):  # the parent is gone
        while True:
            pipe.send_bytes(answer(runner, pipe.recv()))
