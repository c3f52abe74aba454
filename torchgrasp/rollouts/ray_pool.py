"""Episodes on the machines of a Ray cluster."""

from __future__ import annotations

import math
import os
import pickle
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from types import ModuleType
from typing import Any

import torch

from torchgrasp.errors import ConfigError
from torchgrasp.interruption import keep_handlers
from torchgrasp.rollouts.episode_pool import MakeEnv, Policy
from torchgrasp.rollouts.worker_pool import Task, Worker, WorkerLostError, WorkerPool, answer

_START_SECONDS = 120.0  # for a machine to import torch; longer means that there is no room for the worker


class RayPool(WorkerPool):
    """Runs episodes in `num_workers` Ray actors; see `WorkerPool`.

    Ray is joined where `address` says, or started on this machine alone and ended with the pool; a Ray
    that is running already in this process is used as it is. One that is started here listens to 127.0.0.1
    alone. The policy goes to each machine once a call of `run`. Environments are pickled by value where Ray's
    workers could not import them.

    Args:
        envs: name -> function that makes the environment.
        num_workers: actors.
        keep: as for every pool.
        address: of a running cluster, ``auto`` for this machine's; None starts one here.
        num_cpus: cores that Ray sets aside for each actor.
        init: more arguments of `ray.init`, such as `runtime_env`.
    """

    def __init__(
        self,
        envs: Mapping[str, MakeEnv],
        *,
        num_workers: int,
        keep: Iterable | None = None,
        address: str | None = None,
        num_cpus: float = 1.0,
        init: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(envs, num_workers=num_workers, keep=keep)
        self._ray = import_ray()
        cores = num_workers * num_cpus
        self._owns_ray = not self._ray.is_initialized()
        if self._owns_ray:
            own = {"num_cpus": math.ceil(cores), "include_dashboard": False} if address is None else {}
            try:
                _check_address(address)
                alone = _on_this_machine(self._ray) if address is None else nullcontext()
                with alone, keep_handlers():  # Ray would exit at SIGTERM
                    self._ray.init(address or "local", **{"logging_level": "warning", **own, **(init or {})})
            except OSError as error:
                raise ConfigError(
                    f"address={address} does not answer ({error}): begin a cluster by `ray start --head`."
                ) from error
        found = self._ray.cluster_resources().get("CPU", 0)
        if found < cores:
            self.close()
            raise ConfigError(
                f"num_workers={num_workers} of {num_cpus:g} cores each do not fit the {found:g} cores of the "
                "Ray cluster: let more machines join by `ray start --address=...`, or lower it."
            )
        # Without max_restarts: of what Ray restarts by itself nobody here is told.
        self._actor = self._ray.remote(num_cpus=num_cpus)(_RemoteRunner)
        self._packed = self._ray.cloudpickle.dumps(self._runner)

    def _start_worker(self, index: int) -> Worker:
        return RayWorker(self._ray, index, self._actor.remote(sys.path, self._packed))

    def _publish(self, policy: Policy) -> Any:
        return self._ray.put(self._ray.cloudpickle.dumps(policy))

    def close(self) -> None:
        """End the actors, and Ray where this pool began it."""
        super().close()
        if self._owns_ray:
            self._ray.shutdown()


class RayWorker(Worker):
    """An actor somewhere in the cluster.

    Args:
        ray: the module.
        index: of the worker in its pool.
        actor: a `_RemoteRunner`.
    """

    def __init__(self, ray: ModuleType, index: int, actor: Any) -> None:
        self._ray, self._actor, self._name, self._placed = ray, actor, f"Worker {index}", False

    def run(self, task: Task) -> bytes:
        """Call the actor and wait for its answer, and before the first one until it has a place."""
        if not self._placed:
            place = self._wait_for(self._actor.whereabouts.remote(), timeout=_START_SECONDS)
            self._name, self._placed = f"{self._name} ({place})", True
        return self._wait_for(self._actor.run.remote(*task))

    def _wait_for(self, call: Any, *, timeout: float | None = None) -> Any:
        errors = self._ray.exceptions
        try:
            return self._ray.get(call, timeout=timeout)
        except errors.GetTimeoutError as error:
            self.stop()
            raise WorkerLostError(f"{self._name} found no machine with room in {timeout:g} s") from error
        except (errors.RayActorError, errors.OutOfMemoryError) as error:
            raise WorkerLostError(f"{self._name} was lost ({_tell_loss(error)})") from error

    def stop(self) -> None:
        """Kill the actor; it holds nothing that anybody misses."""
        self._ray.kill(self._actor)


def import_ray() -> ModuleType:
    """Ray, or ConfigError with the way to get it."""
    # Ray reports each use to its makers unless told otherwise; who wants that sets it to 1.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise ConfigError(f'RayPool needs the extra ray ({error}): pip install "torchgrasp[ray]".') from error
    return ray


@contextmanager
def _on_this_machine(ray: ModuleType) -> Iterator[None]:
    """Let a Ray that is started here listen to this machine alone.

    Ray does so where clusters are switched off, which the environment tells it when it is imported: TorchRL
    has done that by now. An address of 127.0.0.1 would be replaced by that of the network.
    """
    constants = ray._private.ray_constants
    before = getattr(constants, "ENABLE_RAY_CLUSTER", True)
    constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        constants.ENABLE_RAY_CLUSTER = before


def _check_address(address: str | None) -> None:
    """Raise OSError where nothing listens at host:port; Ray itself would try for minutes, then exit."""
    host, _, port = (address or "").rpartition("://")[2].rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host, int(port)), timeout=10).close()


def _tell_loss(error: Exception) -> str:
    """The line of Ray's page of text that says how an actor was lost."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    told = [line for line in lines if line.startswith("The actor is dead because")]
    return (told or lines or ["Ray tells no reason"])[0]


class _RemoteRunner:
    """What an actor is: an EpisodeRunner that was unpickled where this process's modules are found."""

    def __init__(self, path: list[str], runner: bytes) -> None:
        sys.path += [each for each in path if each not in sys.path]
        torch.set_num_threads(1)
        self._runner = pickle.loads(runner)

    def whereabouts(self) -> str:
        import ray

        return f"process {os.getpid()} on {ray.util.get_node_ip_address()}"

    def run(self, env: str, policy: bytes, number: int, explore: bool) -> bytes:
        return answer(self._runner, Task(env, policy, number, explore))
