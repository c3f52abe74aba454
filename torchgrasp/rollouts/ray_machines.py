"""The machines of a Ray cluster: which of them may run this one's episodes, and whether they are there."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Any

from torchgrasp.errors import ConfigError
from torchgrasp.rollouts import machines
from torchgrasp.rollouts.episode_pool import MakeEnv

_ANSWER_SECONDS = 120.0  # for a machine to import torch and list its objects
_LOOK_SECONDS = 2.0  # between two looks whether its answer is still wanted
_KNOCK_SECONDS = 3.0


class MachineCheck:
    """Compares machines with this one, each once; see `torchgrasp.rollouts.machines`.

    Args:
        ray: the module, joined to a cluster.
        envs: name -> function that makes the environment; those that are `Portable` are compared.
    """

    def __init__(self, ray: ModuleType, envs: Mapping[str, MakeEnv]) -> None:
        self._ray = ray
        ray.cloudpickle.register_pickle_by_value(machines)  # another machine may lack it
        self._versions, self._envs = machines.look([]), ray.cloudpickle.dumps(dict(envs))
        self._ingredients: dict[str, dict[str, str]] | str | None = None
        self._told: dict[str, str | None] = {}
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Wait for no machine any more: one that is asked counts as one that does not answer."""
        self._stopped.set()

    def check_all(self) -> None:
        """Raise ConfigError that names each machine that would not give this one's episodes, and why."""
        nodes = [each for each in self._ray.nodes() if each["Alive"] and each["Resources"].get("CPU", 0)]
        self._look_here()
        with ThreadPoolExecutor(max(1, len(nodes))) as threads:
            found = threads.map(self.difference, [each["NodeID"] for each in nodes])
            told = [f"{name_machine(node)} {what}" for node, what in zip(nodes, found, strict=True) if what]
        if told:
            raise ConfigError("Machines of the Ray cluster cannot run these episodes. " + " ".join(told))

    def difference(self, node_id: str) -> str | None:
        """What keeps a machine from running this one's episodes, with the remedy; None where nothing does."""
        errors = self._ray.exceptions
        try:
            if node_id not in self._told:
                self._told[node_id] = self._compare(node_id)
            return self._told[node_id]
        except errors.GetTimeoutError:
            return f"does not answer in {_ANSWER_SECONDS:g} s: end its Ray, or connect it."
        except errors.RayError as error:
            return (
                f"was lost while it was asked what it has ({first_line(error)}): end its Ray, or connect it."
            )

    def _look_here(self) -> dict[str, dict[str, str]]:
        if self._ingredients is None:
            self._ingredients = machines.look_inside([], self._envs)
        if isinstance(self._ingredients, str):
            raise ConfigError(self._ingredients)
        return self._ingredients

    def _compare(self, node_id: str) -> str | None:
        here = self._look_here()
        versions = self._ask(node_id, machines.look, sys.path)
        if (told := machines.tell_versions(self._versions, versions)) is not None:
            return f"has {told}: install the same torchgrasp and the versions of constraints.txt there."
        there = self._ask(node_id, machines.look_inside, sys.path, self._envs)
        if isinstance(there, str):
            return f"cannot make the environments: {there}"
        if (told := machines.tell_ingredients(here, there)) is not None:
            return f"has {told}: put the same files under the same paths there."
        return None

    def _ask(self, node_id: str, function: Callable, *args: Any) -> Any:
        """What a function returns on a machine."""
        strategies = self._ray.util.scheduling_strategies
        there = strategies.NodeAffinitySchedulingStrategy(node_id, soft=False)
        remote = self._ray.remote(num_cpus=0, max_retries=0, scheduling_strategy=there)(function)
        told, until = remote.remote(*args), time.monotonic() + _ANSWER_SECONDS
        while True:
            try:
                return self._ray.get(told, timeout=_LOOK_SECONDS)
            except self._ray.exceptions.GetTimeoutError:
                if self._stopped.is_set() or time.monotonic() > until:
                    self._ray.cancel(told, force=True)
                    raise


def name_machine(node: Mapping[str, Any]) -> str:
    """A machine by its own name and its address."""
    return f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']})"


def find_machine(ray: ModuleType, node_id: str) -> Mapping[str, Any] | None:
    """What Ray tells of a machine, None where it knows of none."""
    return next((each for each in ray.nodes() if each["NodeID"] == node_id), None)


def answers(ray: ModuleType, node_id: str) -> bool:
    """Whether a machine is there: Ray itself notices after some time that one is cut off or killed."""
    node = find_machine(ray, node_id)
    if node is None or not node["Alive"]:
        return False
    try:
        place = node["NodeManagerAddress"], node["NodeManagerPort"]
        socket.create_connection(place, timeout=_KNOCK_SECONDS).close()
    except OSError:
        return False
    return True


def first_line(error: Exception) -> str:
    """The line of Ray's page of text that says how an actor or a machine was lost."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    told = [line for line in lines if line.startswith("The actor is dead because")]
    return (told or lines or ["Ray tells no reason"])[0]
