"""Episodes on the machines of a Ray cluster."""

from __future__ import annotations

import math
import os
import socket
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from types import ModuleType
from typing import Any

from torchgrasp.errors import ConfigError
from torchgrasp.interruption import keep_handlers
from torchgrasp.rollouts import remote_runner
from torchgrasp.rollouts.episode_pool import MakeEnv, Policy
from torchgrasp.rollouts.ray_machines import MachineCheck, answers, first_line
from torchgrasp.rollouts.worker_pool import Task, Worker, WorkerLostError, WorkerPool

_LOOK_SECONDS = 2.0  # between two looks at whether an actor has a place


class RayPool(WorkerPool):
    """Runs episodes in `num_workers` Ray actors; see `WorkerPool`.

    Ray is joined where `address` says, or started on this machine alone and ended with the pool; a Ray
    that is running already in this process is used as it is. One that is started here listens to 127.0.0.1
    alone. The policy goes to each machine once a call of `run`. Environments are pickled by value where Ray's
    workers could not import them.

    Machines of a cluster are compared with this one first: versions, code, and what environments that are
    `machines.Portable` read there. A machine that is killed or cut off costs the episodes that it was at,
    which are run again elsewhere; its actors wait for a machine with room, such as itself once it is back.

    Args:
        envs: name -> function that makes the environment.
        num_workers: actors.
        keep: as for every pool.
        address: of a running cluster, ``auto`` for this machine's; None starts one here.
        num_cpus: cores that Ray sets aside for each actor.
        patience: seconds in which no machine at all may have room for an actor before that is an error.
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
        patience: float = 120.0,
        init: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(envs, num_workers=num_workers, keep=keep, patience=patience)
        self._ray = import_ray()
        self._ray.cloudpickle.register_pickle_by_value(remote_runner)  # another machine may lack it
        self._machines: MachineCheck | None = None  # this one alone needs none
        self._answered: list[str] = []
        self._owns_ray = not self._ray.is_initialized()
        if self._owns_ray:
            own = {"num_cpus": math.ceil(num_workers * num_cpus), "include_dashboard": False}
            own = own if address is None else {}
            try:
                _check_address(address)
                alone = _on_this_machine(self._ray) if address is None else nullcontext()
                with alone, keep_handlers():  # Ray would exit at SIGTERM
                    self._ray.init(address or "local", **{"logging_level": "warning", **own, **(init or {})})
            except OSError as error:
                raise ConfigError(
                    f"address={address} does not answer ({error}): begin a cluster by `ray start --head`."
                ) from error
        try:
            self._check_room(num_workers, num_cpus)
            if not (self._owns_ray and address is None):
                self._machines = MachineCheck(self._ray, self._runner.factories)
                self._machines.check_all()
        except BaseException:
            self.close()
            raise
        # Without max_restarts: of what Ray restarts by itself nobody here is told.
        options = {"num_cpus": num_cpus, "scheduling_strategy": "SPREAD"}
        self._actor = self._ray.remote(**options)(remote_runner.RemoteRunner)
        self._packed = self._ray.cloudpickle.dumps(self._runner)

    def _check_room(self, num_workers: int, num_cpus: float) -> None:
        found, cores = self._ray.cluster_resources().get("CPU", 0), num_workers * num_cpus
        if found < cores:
            raise ConfigError(
                f"num_workers={num_workers} of {num_cpus:g} cores each do not fit the {found:g} cores of the "
                "Ray cluster: let more machines join by `ray start --address=...`, or lower it."
            )

    def _start_worker(self, index: int) -> Worker:
        actor = self._actor.remote(sys.path, self._packed)
        return RayWorker(self._ray, index, actor, machines=self._machines, answered=self._answered)

    def _publish(self, policy: Policy) -> Any:
        return self._ray.put(self._ray.cloudpickle.dumps(policy))

    @property
    def answered(self) -> Counter[str]:
        """Address of a machine -> episode numbers that it has run, those that were lost left out."""
        return Counter(self._answered)

    def close(self) -> None:
        """End the actors, and Ray where this pool began it."""
        if self._machines is not None:
            self._machines.stop()
        super().close()
        if self._machines is not None and self._answered:
            counts = ", ".join(f"{count} on {each}" for each, count in sorted(self.answered.items()))
            print(f"Episode numbers that were run: {counts}.")
            self._answered.clear()
        if self._owns_ray:
            self._ray.shutdown()


class RayWorker(Worker):
    """An actor somewhere in the cluster.

    Args:
        ray: the module.
        index: of the worker in its pool.
        actor: a `RemoteRunner`.
        machines: tells which ones may run it; None for any.
        answered: the address of its machine is put here with each answer.
    """

    def __init__(
        self, ray: ModuleType, index: int, actor: Any, *, machines: MachineCheck | None, answered: list[str]
    ) -> None:
        self._ray, self._actor, self._name = ray, actor, f"Worker {index}"
        self._machines, self._answered = machines, answered
        self._node, self._address = "", ""
        self.ready = False

    def settle(self, is_hopeless: Callable[[], bool]) -> None:
        """Wait until a machine has room for the actor, and see whether it may run it."""
        place = self._actor.place.remote()
        while True:
            with suppress(self._ray.exceptions.GetTimeoutError):
                self._node, self._address, process = self._wait_for(place, timeout=_LOOK_SECONDS)
                break
            if is_hopeless():
                raise WorkerLostError(f"{self._name} finds no machine with room")
        different = None if self._machines is None else self._machines.difference(self._node)
        if different is not None:
            raise WorkerLostError(f"{self._name} cannot work on {self._address}, which {different}")
        self._wait_for(self._actor.load.remote())
        self._name = f"{self._name} (process {process} on {self._address})"
        if self._machines is not None:
            print(f"{self._name} runs episodes.", flush=True)
        self.ready = True

    def run(self, task: Task) -> bytes:
        """Call the actor and wait for its answer."""
        packed = self._wait_for(self._actor.run.remote(*task))
        self._answered.append(self._address)
        return packed

    def _wait_for(self, call: Any, *, timeout: float | None = None) -> Any:
        errors = self._ray.exceptions
        try:
            return self._ray.get(call, timeout=timeout)
        except (errors.GetTimeoutError, errors.RayTaskError):
            raise
        except errors.RayError as error:  # the actor, its machine, or what it had answered
            gone = bool(self._node) and not answers(self._ray, self._node)
            how = "its machine does not answer" if gone else first_line(error)
            raise WorkerLostError(f"{self._name} was lost ({how})", blameless=gone) from error

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
